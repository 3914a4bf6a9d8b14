"""A participant of a SIL Kit simulation that sends 300 frames a second, of a message that nobody follows, to its end.

python can_silkit/tests/bystander.py --registry silkit://localhost:8500
"""

import argparse
import threading
from contextlib import suppress

import can

from can_silkit import SilKitBus

FRAMES_PER_S = 300


def main() -> None:
    """Send until the simulation ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--registry", default="silkit://localhost:8500")
    parser.add_argument("--seconds", type=float, default=3600.0, help="of virtual time")
    options = parser.parse_args()
    stop = threading.Event()
    with SilKitBus("CAN1", options.registry, "bystander") as bus, suppress(can.CanError):
        for number in range(round(options.seconds * FRAMES_PER_S)):
            bus.clock.sleep_until(number / FRAMES_PER_S, stop)
            message = can.Message(arbitration_id=0x3E9, is_extended_id=False, data=number.to_bytes(8, "big"))
            message.timestamp = number / FRAMES_PER_S
            bus.send(message)


if __name__ == "__main__":
    main()
