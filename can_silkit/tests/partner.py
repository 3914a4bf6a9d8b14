"""A participant of a SIL Kit simulation, of SIL Kit's own binding alone: it ends, crashes, hangs, or asks a controller.

python can_silkit/tests/partner.py silkit://localhost:8500 bench --until 5 --then crash

Prints what it saw as JSON if it comes to an end.
"""

import argparse
import asyncio
import json
import os
import signal
import sys
import time
from typing import Any

import SilKit_py as silkit

REQUEST_ID, RESPONSE_ID = 0x7E1, 0x7E9
TESTER_PRESENT, PRESENT = bytes.fromhex("023e00cccccccccc"), 0x7E
ASK_EVERY_NS = 100_000_000
LAST_ANSWER_NS = 1_000_000_000  # is waited for, after the last question
NS_PER_S = 1e9
NS_PER_MS = 1e6
HANG_S = 100_000.0
DOES = {"crash": "crashes now", "hang": "hangs now"}


def say(line: str) -> None:
    """Write a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


class Partner:
    """Takes part with one CAN controller until its time has come."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.end_ns = round(options.until * NS_PER_S)
        self.then: str = options.then
        self.is_asking: bool = options.ask
        self.has_begun = False
        self.received = 0
        self.asked_ns: list[int] = []
        self.answered_ns: list[int] = []
        participant = silkit.create_participant(
            silkit.participant_configuration_from_String("{}"), options.name, options.registry
        )
        mode = silkit.OperationMode.Autonomous if options.autonomous else silkit.OperationMode.Coordinated
        self.lifecycle = participant.create_lifecycle_service(silkit.LifecycleConfiguration(mode))
        self.controller = controller = participant.create_can_controller("CAN1", "CAN1")
        directions = int(silkit.TransmitDirection.RX)
        self.lifecycle.set_communication_ready_handler(  # frames that come before would stop the binding for ever
            lambda: (
                controller.add_frame_handler(self.on_frame, directions),
                controller.set_baud_rate(500_000, 0, 0),
                controller.start(),
            )
        )
        step_ns = round(options.step_ms * NS_PER_MS)
        self.lifecycle.create_time_sync_service().set_simulation_step_handler(self.on_step, step_ns)
        self.participant = participant

    def on_frame(self, _: object, event: Any) -> None:  # noqa: ANN401 - SIL Kit's
        self.received += 1
        if event.frame.can_id == RESPONSE_ID and event.frame.data[1] == PRESENT:
            self.answered_ns.append(event.timestamp)

    def on_step(self, now_ns: int, _duration_ns: int) -> None:
        if not self.has_begun:
            self.has_begun = True
            say("has begun")
        if self.is_asking and 0 < now_ns < self.end_ns - LAST_ANSWER_NS and now_ns % ASK_EVERY_NS == 0:
            self.asked_ns.append(now_ns)
            self.controller.send_frame(REQUEST_ID, TESTER_PRESENT)
        if now_ns < self.end_ns:
            return
        if self.then != "end":
            say(DOES[self.then])
        if self.then == "crash":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.then == "hang":
            time.sleep(HANG_S)
        self.end_ns = sys.maxsize
        self.lifecycle.stop("has done its part")

    def run(self) -> dict[str, object]:
        """Take part to the end, and return what was seen."""
        state = asyncio.run(self.lifecycle.start_lifecycle())
        waits_ms = [
            min((answer_ns - asked_ns for answer_ns in self.answered_ns if answer_ns >= asked_ns), default=sys.maxsize)
            / NS_PER_MS
            for asked_ns in self.asked_ns
        ]
        return {
            "state": state.name,
            "received": self.received,
            "asked": len(self.asked_ns),
            "answered": len(self.answered_ns),
            "longest_wait_ms": max(waits_ms, default=0.0),
        }


def main() -> None:
    """Take part as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("registry")
    parser.add_argument("name")
    parser.add_argument("--until", type=float, default=1e6, help="virtual time")
    parser.add_argument("--then", choices=("end", "crash", "hang"), default="end")
    parser.add_argument("--step-ms", type=float, default=1.0)
    parser.add_argument("--autonomous", action="store_true", help="joins and leaves as it likes, unknown to others")
    parser.add_argument("--ask", action="store_true", help="the controller every 100 ms whether it is there")
    say(json.dumps(Partner(parser.parse_args()).run()))


if __name__ == "__main__":
    main()
