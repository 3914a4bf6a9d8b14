"""Frames of all kinds from one participant of a SIL Kit simulation to another, each of which is compared.

python can_silkit/tests/exchange.py --seconds 60 --registry silkit://localhost:8500

A registry has to run there; its system controller is started here. Prints what came as JSON, and fails if not all did.
"""

import argparse
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import can

from can_silkit import SilKitBus

FRAMES_PER_MS = 5
HANG_S = 300.0


def frame(number: int) -> can.Message:
    """Return the frame of a number: standard, extended, of CAN FD, remote and error frames in turn."""
    t_s = number // FRAMES_PER_MS / 1e3
    content = number.to_bytes(8, "big")
    kinds = (
        can.Message(arbitration_id=number % 0x800, is_extended_id=False, data=content[: number % 9]),
        can.Message(arbitration_id=number, is_extended_id=True, data=content),
        can.Message(arbitration_id=0x7FF, is_extended_id=False, is_fd=True, bitrate_switch=True, data=content * 8),
        can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=number % 9),
        can.Message(arbitration_id=0x40, is_extended_id=False, is_error_frame=True, data=content),
        can.Message(arbitration_id=1, is_fd=True, error_state_indicator=True, data=content + bytes(4)),
    )
    message = kinds[number % len(kinds)]
    message.timestamp = t_s
    return message


def send(bus: SilKitBus, frame_count: int) -> None:
    stop = threading.Event()
    for number in range(frame_count):
        if number % FRAMES_PER_MS == 0:
            bus.clock.sleep_until(number // FRAMES_PER_MS / 1e3, stop)
        bus.send(frame(number))
    if bus.recv(0.0) is not None:
        sys.exit("the sender hears itself")


def receive(bus: SilKitBus, frame_count: int) -> dict[str, object]:
    received = different = 0
    began_s = time.monotonic()
    while received < frame_count and (message := bus.recv(HANG_S)) is not None:
        expected = frame(received)
        different += not message.equals(expected, timestamp_delta=1e-9, check_channel=False, check_direction=False)
        received += 1
    return {
        "sent": frame_count,
        "received": received,
        "different": different,
        "dropped": bus.dropped,
        "seconds": round(time.monotonic() - began_s, 1),
    }


def main() -> None:
    """Start sender and system controller as processes of their own, and receive here."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of virtual time")
    parser.add_argument("--registry", default="silkit://localhost:8500")
    parser.add_argument("--role", choices=("both", "send"), default="both")
    options = parser.parse_args()
    frame_count = round(options.seconds * 1e3) * FRAMES_PER_MS
    if options.role == "send":
        with SilKitBus("CAN1", options.registry, "sender", fd=True) as bus:
            send(bus, frame_count)
        return
    again = [sys.executable, __file__, "--role", "send", "--registry", options.registry]
    controller = Path(sys.executable).with_name("silkit-system-controller")
    with (
        subprocess.Popen([controller, "-u", options.registry, "-l", "off", "sender", "receiver"]) as controlling,
        subprocess.Popen([*again, "--seconds", str(options.seconds)]) as sending,
    ):
        with SilKitBus("CAN1", options.registry, "receiver", step_s=0.01, fd=True) as bus:
            result = receive(bus, frame_count)
        statuses = sending.wait(), controlling.wait()
    print(json.dumps(result))
    sys.exit(result["received"] != frame_count or result["different"] != 0 or statuses != (0, 0))


if __name__ == "__main__":
    main()
