"""A small CAN gateway: every frame of one bus goes out on another. It stands for a program of somebody else.

    python gateway.py '{"interface": "socketcan", "channel": "can0"}' '{"interface": "socketcan", "channel": "can1"}'

For the demonstration it can be made to have a fault: ``--fault drop`` forgets every twentieth frame of an identifier,
``--fault alter`` changes a bit in it, ``--fault swap`` sends it behind its successor.
"""

import argparse
import json
import signal
import sys
from collections import Counter
from collections.abc import Callable
from threading import Event

import can

FAULTS = ("none", "drop", "alter", "swap")
EVERY = 20
POLL_S = 0.1


class Gateway:
    """Forwards frames, and does with every twentieth of an identifier what its fault says."""

    def __init__(self, target: can.BusABC, fault: str) -> None:
        self._target = target
        self._fault = fault
        self._counts: Counter[int] = Counter()
        self._held: dict[int, can.Message] = {}

    def forward(self, message: can.Message) -> None:
        self._counts[message.arbitration_id] += 1
        is_struck = self._counts[message.arbitration_id] % EVERY == 0
        if is_struck and self._fault == "drop":
            return
        if is_struck and self._fault == "swap":
            self._held[message.arbitration_id] = message
            return
        if is_struck and self._fault == "alter":
            message.data[3] ^= 0x10
        self._target.send(outgoing(message))
        if held := self._held.pop(message.arbitration_id, None):
            self._target.send(outgoing(held))


def outgoing(received: can.Message) -> can.Message:
    """Return a new message for the other bus: when the old one was received is none of its business."""
    return can.Message(
        arbitration_id=received.arbitration_id,
        is_extended_id=received.is_extended_id,
        is_remote_frame=received.is_remote_frame,
        is_error_frame=received.is_error_frame,
        is_fd=received.is_fd,
        bitrate_switch=received.bitrate_switch,
        error_state_indicator=received.error_state_indicator,
        dlc=received.dlc,
        data=received.data,
    )


def run(source: dict, target: dict, fault: str, stop: Event, on_ready: Callable[[], None]) -> None:
    """Forward frames until told to stop; buses are named as ``can.Bus`` takes them."""
    with can.Bus(**source) as near, can.Bus(**target) as far:
        gateway = Gateway(far, fault)
        on_ready()
        while not stop.is_set():
            if (message := near.recv(timeout=POLL_S)) is not None:
                gateway.forward(message)


def main() -> int:
    parser = argparse.ArgumentParser(description="Forwards every frame of one CAN bus to another.")
    parser.add_argument("source", type=json.loads, help="arguments of can.Bus, as JSON")
    parser.add_argument("target", type=json.loads, help="likewise")
    parser.add_argument("--fault", choices=FAULTS, default="none")
    options = parser.parse_args()
    stop = Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    run(options.source, options.target, options.fault, stop, on_ready=lambda: print("forwarding", flush=True))
    return 0


if __name__ == "__main__":
    sys.exit(main())
