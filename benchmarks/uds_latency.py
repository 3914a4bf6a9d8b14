"""How long a tester waits for an answer beside the full stream of frames, and what its questions cost the stream.

    python -m benchmarks.uds_latency [-i INTERFACE -c CHANNEL] [--seconds 20] [--rate 50]

Emulator, controller and tester share one process and its interpreter on the virtual bus: figures are upper bounds.
"""

import argparse
import threading
import time
from dataclasses import dataclass
from typing import Self

import can
import isotp
import numpy as np

from ecu_emulator.answering import Answering
from ecu_emulator.bus import TransmitReport, transmit
from ecu_emulator.live import own_ids
from ecu_emulator.other_senders import OtherSenders
from ecu_emulator.recording import SHORT_STRETCH_S, Drive
from ecu_emulator.scenario_file import load_scenario

REQUEST_ID, RESPONSE_ID = 0x7E1, 0x7E9
SHORT, LONG = b"\x22\x01\x05", b"\x22\xf1\x90"  # one frame back; three and a flow control
MOST_S = 0.01
FULL_STREAM_S = 2.0
MS_PER_S = 1e3


@dataclass
class Figures:
    report: TransmitReport
    latencies_s: list[float]
    unanswered: int


class Tester:
    """Asks at a steady rate, in a thread of its own, from when the stream is full until it is told to stop."""

    def __init__(self, bus: can.BusABC, rate_hz: float, stop: threading.Event) -> None:
        self._notifier = can.Notifier(bus, [], timeout=0.01)
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=REQUEST_ID, rxid=RESPONSE_ID)
        self._stack = isotp.NotifierBasedCanStack(bus, self._notifier, address=address)
        self._rate_hz = rate_hz
        self._stop = stop
        self._thread = threading.Thread(target=self._ask)
        self.latencies_s: list[float] = []
        self.unanswered = 0

    def __enter__(self) -> Self:
        self._stack.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._stack.stop()
        self._notifier.stop()

    def _ask(self) -> None:
        self._stop.wait(FULL_STREAM_S)
        next_s = time.monotonic()
        while not self._stop.wait(max(0.0, next_s - time.monotonic())) and self._rate_hz > 0.0:
            next_s += 1.0 / self._rate_hz
            began_s = time.perf_counter()
            self._stack.send(LONG if len(self.latencies_s) % 5 == 4 else SHORT)
            if self._stack.recv(block=True, timeout=2.0) is None:
                self.unanswered += 1
            else:
                self.latencies_s.append(time.perf_counter() - began_s)


def measured(interface: str, channel: str, seconds: float, rate_hz: float) -> Figures:
    """Drive for so long with a tester that asks at this rate."""
    drive = Drive(load_scenario("ideal"))
    stop = threading.Event()
    with (
        can.Bus(channel, interface) as near,
        can.Bus(channel, interface) as far,
        Answering(near, table="", memory=None, doip=None, is_fd=False) as answering,
        OtherSenders(near, own_ids(), lambda _: None, wanted_ids=answering.link.can_ids, pass_on=answering.link.feed),
        Tester(far, rate_hz, stop) as tester,
    ):
        frames = (stretch.frames for stretch in drive.stretches(SHORT_STRETCH_S))
        timer = threading.Timer(seconds + FULL_STREAM_S, stop.set)
        timer.start()
        report = transmit(answering, frames, stop)
        timer.cancel()
    return Figures(report=report, latencies_s=tester.latencies_s, unanswered=tester.unanswered)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-i", "--interface", default="virtual")
    parser.add_argument("-c", "--channel", default="uds latency")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=50.0, help="requests a second")
    options = parser.parse_args()
    for rate_hz in (0.0, options.rate):
        found = measured(options.interface, options.channel, options.seconds, rate_hz)
        report = found.report
        print(
            f"{rate_hz:3.0f} requests/s: {report.frames_sent / report.duration_s:.0f} frames/s, lateness p99 "
            f"{report.lateness_p99_s * MS_PER_S:.2f} ms, {report.overruns} overruns, {report.underruns} underruns"
        )
        if found.latencies_s:
            p50_s, p99_s = np.quantile(found.latencies_s, (0.5, 0.99))
            print(
                f"    {len(found.latencies_s)} answers, p50 {p50_s * MS_PER_S:.2f} ms, p99 {p99_s * MS_PER_S:.2f} ms "
                f"(target {MOST_S * MS_PER_S:.0f}), max {max(found.latencies_s) * MS_PER_S:.2f} ms, "
                f"{found.unanswered} unanswered"
            )


if __name__ == "__main__":
    main()
