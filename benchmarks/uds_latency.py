"""How long a tester waits for an answer beside the full stream of frames, and what its questions cost the stream.

    python -m benchmarks.uds_latency [-i INTERFACE -c CHANNEL] [--seconds 20] [--rate 50] [--doip]

Emulator, controller and tester share one process and its interpreter on the virtual bus: figures are upper bounds.
"""

import argparse
import threading
import time
from dataclasses import dataclass
from typing import Any, Self

import can
import doipclient.client
import isotp
import numpy as np

from ecu_emulator.answering.answering_tester import Answering
from ecu_emulator.bus.sender import TransmitReport, transmit
from ecu_emulator.diagnostics.doip.listening import Place, parse_place
from ecu_emulator.drive.recording import SHORT_STRETCH_S, Drive
from ecu_emulator.live.live_drive import own_ids
from ecu_emulator.live.other_senders import OtherSenders
from ecu_emulator.scenario.scenario_file import load_scenario

REQUEST_ID, RESPONSE_ID = 0x7E1, 0x7E9
SHORT, LONG = b"\x22\x01\x05", b"\x22\xf1\x90"  # one frame back; three and a flow control
LOGICAL_ADDRESS = 0x1011
MOST_S = 0.01  # p99 wanted on a virtual bus
MOST_ON_BUS_S = 0.025  # and in the guest, on a real one
SILENCE_S = 2.0
FULL_STREAM_S = 2.0
MS_PER_S = 1e3


@dataclass
class Figures:
    report: TransmitReport
    latencies_s: list[float]
    unanswered: int


class OnCan:
    """Requests over ISO-TP."""

    def __init__(self, bus: can.BusABC) -> None:
        self._notifier = can.Notifier(bus, [], timeout=0.01)
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=REQUEST_ID, rxid=RESPONSE_ID)
        self._stack = isotp.NotifierBasedCanStack(bus, self._notifier, address=address)
        self._stack.start()

    def is_answered(self, request: bytes) -> bool:
        self._stack.send(request)
        return self._stack.recv(block=True, timeout=SILENCE_S) is not None

    def close(self) -> None:
        self._stack.stop()
        self._notifier.stop()


class OverIp:
    """Requests over DoIP, by a client that is not ours."""

    def __init__(self, place: Place) -> None:
        connect: Any = doipclient.client.DoIPClient  # the library says nothing of types
        self._client = connect(place.host, LOGICAL_ADDRESS, tcp_port=place.port)

    def is_answered(self, request: bytes) -> bool:
        self._client.send_diagnostic(bytearray(request))
        try:
            return bool(self._client.receive_diagnostic(timeout=SILENCE_S))
        except TimeoutError:
            return False

    def close(self) -> None:
        self._client.close()


class Tester:
    """Asks at a steady rate, in a thread of its own, from when the stream is full until it is told to stop."""

    def __init__(self, way: OnCan | OverIp, rate_hz: float, stop: threading.Event) -> None:
        self._way = way
        self._rate_hz = rate_hz
        self._stop = stop
        self._thread = threading.Thread(target=self._ask)
        self.latencies_s: list[float] = []
        self.unanswered = 0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._way.close()

    def _ask(self) -> None:
        self._stop.wait(FULL_STREAM_S)
        next_s = time.monotonic()
        while not self._stop.wait(max(0.0, next_s - time.monotonic())) and self._rate_hz > 0.0:
            next_s += 1.0 / self._rate_hz
            began_s = time.perf_counter()
            if not self._way.is_answered(LONG if len(self.latencies_s) % 5 == 4 else SHORT):
                self.unanswered += 1
            else:
                self.latencies_s.append(time.perf_counter() - began_s)


def measured(interface: str, channel: str, seconds: float, rate_hz: float, place: Place | None) -> Figures:
    """Drive for so long with a tester that asks at this rate."""
    drive = Drive(load_scenario("ideal"))
    stop = threading.Event()
    with (
        can.Bus(channel, interface) as near,
        can.Bus(channel, interface) as far,
        Answering(near, table="", memory=None, doip=place, is_fd=False) as answering,
        OtherSenders(near, own_ids(), lambda _: None, wanted_ids=answering.link.can_ids, pass_on=answering.link.feed),
        Tester(OnCan(far) if place is None else OverIp(place), rate_hz, stop) as tester,
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
    parser.add_argument("--doip", metavar="PORT", help="ask over DoIP on this port of the loopback interface")
    options = parser.parse_args()
    place = None if options.doip is None else parse_place(options.doip)
    most_s = MOST_S if options.interface == "virtual" else MOST_ON_BUS_S
    for rate_hz in (0.0, options.rate):
        found = measured(options.interface, options.channel, options.seconds, rate_hz, place)
        report = found.report
        print(
            f"{rate_hz:3.0f} requests/s: {report.frames_sent / report.duration_s:.0f} frames/s, lateness p99 "
            f"{report.lateness_p99_s * MS_PER_S:.2f} ms, {report.overruns} overruns, {report.underruns} underruns"
        )
        if found.latencies_s:
            p50_s, p99_s = np.quantile(found.latencies_s, (0.5, 0.99))
            print(
                f"    {len(found.latencies_s)} answers, p50 {p50_s * MS_PER_S:.2f} ms, p99 {p99_s * MS_PER_S:.2f} ms "
                f"(target {most_s * MS_PER_S:.0f}), max {max(found.latencies_s) * MS_PER_S:.2f} ms, "
                f"{found.unanswered} unanswered"
            )


if __name__ == "__main__":
    main()
