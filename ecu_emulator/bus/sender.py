"""Frames onto a bus in the time of a clock: absolute deadlines, measured lateness, nothing lost in silence."""

import errno
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Protocol

import can
import numpy as np

from canlog.errors import SourceError
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG
from canlog.live import multicast, opening, pythoncan
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.errors import BusError

SHORTEST_BIN_S: Final = 1e-6
BIN_GROWTH: Final = 1.02  # a percentile is at most so much too large
BINS: Final = 1_200  # up to 2e4 s, six hours: nothing is ever later
PPM: Final = 1e6
CHUNKS_AHEAD: Final = 8
LONGEST_SLEEP_S: Final = 0.05  # how soon a request to stop is noticed
OVERRUN_S: Final = 0.005  # half of the shortest cycle
RETRY_FOR_S: Final = 0.005
RETRY_PAUSE_S: Final = 0.0005
PROGRESS_PERIOD_S: Final = 0.2
BUS_GONE: Final = frozenset({errno.ENODEV, errno.ENXIO, errno.EBADF, errno.ENETUNREACH})


class SendLateness:
    """Lateness of frames against their deadlines, one value per frame."""

    def __init__(self) -> None:
        self._histogram = np.zeros(BINS, np.int64)
        self._count = 0
        self._sum_t = self._sum_late = self._sum_t_t = self._sum_t_late = 0.0
        self.max_s = 0.0
        self.overruns = 0

    def add(self, due_s: float, lateness_s: float) -> None:
        """Count a frame that was due at ``due_s`` of the schedule and began to be sent this much later."""
        steps = math.log(max(lateness_s / SHORTEST_BIN_S, 1.0)) / math.log(BIN_GROWTH)
        self._histogram[min(int(steps), BINS - 1)] += 1
        self._count += 1
        self._sum_t += due_s
        self._sum_late += lateness_s
        self._sum_t_t += due_s * due_s
        self._sum_t_late += due_s * lateness_s
        self.max_s = max(self.max_s, lateness_s)
        self.overruns += lateness_s > OVERRUN_S

    @property
    def mean_s(self) -> float:
        """Return the mean lateness, 0 without frames."""
        return self._sum_late / self._count if self._count else 0.0

    def quantile_s(self, fraction: float) -> float:
        """Return the lateness that this fraction of the frames did not exceed, at most 2 % or 1 us too large."""
        if self._count == 0:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self._histogram), fraction * self._count))
        return min(SHORTEST_BIN_S * BIN_GROWTH ** (place + 1), self.max_s)

    @property
    def drift_ppm(self) -> float:
        """Return by how much the sent schedule runs slow: the slope of lateness over time, least squares."""
        spread = self._count * self._sum_t_t - self._sum_t * self._sum_t
        if spread <= 0.0:
            return 0.0
        return (self._count * self._sum_t_late - self._sum_t * self._sum_late) / spread * PPM


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmitReport:
    """What was sent and how punctually; lateness is the start of sending against the deadline."""

    frames_sent: int
    frames_given_up: int  # the interface was down, or did not take them in time
    interruptions: int  # times that the interface was down
    retries: int
    duration_s: float
    lateness_mean_s: float
    lateness_p50_s: float
    lateness_p95_s: float
    lateness_p99_s: float
    lateness_max_s: float
    drift_ppm: float  # positive: the sent clock runs slow
    overruns: int  # frames more than half of the shortest cycle late
    underruns: int  # times the next frames were not computed when they were due
    is_complete: bool  # False if stopped before the end
    simulation_ended: bool  # before the drive was complete: another participant ended it in order


class FrameSender(Protocol):
    """What puts frames on a bus."""

    def send(self, message: can.Message) -> None:
        """Send a frame, or raise ``can.CanError``."""


class SendClock(Protocol):
    """The time in which frames are due; it never steps back."""

    LEAD_IN_S: float
    """From the first chunk to the first deadline [s]."""
    step_s: float
    """Frames leave at whole steps of so long [s], 0: at any time."""

    @property
    def has_ended(self) -> bool:
        """Whether this time has come to its regular end, as that of a simulation."""

    def now_s(self) -> float:
        """Return the time [s], as frames carry it."""

    def sleep_until(self, deadline_s: float, stop: threading.Event) -> None:
        """Wait for this time, or until ``stop`` is set; raise ``can.CanError`` if it cannot come any more."""


class WallClock:
    """The time of this machine; steps of its wall clock are not those of the drive."""

    LEAD_IN_S = 0.05
    step_s = 0.0
    has_ended = False

    def __init__(self) -> None:
        self._wall_s = time.time() - time.monotonic()  # once

    def now_s(self) -> float:
        """Return the seconds since the epoch, as they were at the start and have passed since."""
        return self._wall_s + time.monotonic()

    def sleep_until(self, deadline_s: float, stop: threading.Event) -> None:
        """Sleep in slices: a signal handler may ask to stop."""
        while (left_s := deadline_s - self.now_s()) > 0.0 and not stop.is_set():
            time.sleep(min(left_s, LONGEST_SLEEP_S))


def clock_of(bus: object) -> SendClock:
    """Return the clock of a bus that has one, such as that of a simulation, which then waits for us; else our own."""
    clock: SendClock | None = getattr(bus, "clock", None)
    return WallClock() if clock is None else clock


class _Transmitter:
    def __init__(self, bus: FrameSender, clock: SendClock, stop: threading.Event) -> None:
        self._bus = bus
        self._clock = clock
        self._stop = stop
        self._lateness = SendLateness()
        self._is_stuck = False
        self._is_down = False
        self.sent = 0
        self.given_up = 0
        self.interruptions = 0
        self.retries = 0
        self.underruns = 0

    def send_chunk(self, chunk: EncodedFrames, start_s: float) -> None:
        """Send frames when they are due; those due at the same instant go out together."""
        bounds = [*np.flatnonzero(np.diff(chunk.t_s, prepend=-np.inf)).tolist(), len(chunk)]
        for first, end in pairwise(bounds):  # none where a fault has taken every frame
            messages = to_messages(chunk[first:end], start_s)
            due_s = float(chunk.t_s[first])
            deadline_s = start_s + due_s
            try:
                self._clock.sleep_until(deadline_s, self._stop)
            except can.CanError as exc:
                if self._clock.has_ended:
                    return
                raise self._gone(exc) from exc
            if self._stop.is_set():
                return
            for message in messages:
                self._lateness.add(due_s, self._clock.now_s() - deadline_s)
                self._send(message)

    def report(self, duration_s: float, *, is_driven: bool) -> TransmitReport:
        return TransmitReport(
            frames_sent=self.sent,
            frames_given_up=self.given_up,
            interruptions=self.interruptions,
            retries=self.retries,
            duration_s=duration_s,
            lateness_mean_s=self._lateness.mean_s,
            lateness_p50_s=self._lateness.quantile_s(0.50),
            lateness_p95_s=self._lateness.quantile_s(0.95),
            lateness_p99_s=self._lateness.quantile_s(0.99),
            lateness_max_s=self._lateness.max_s,
            drift_ppm=self._lateness.drift_ppm,
            overruns=self._lateness.overruns,
            underruns=self.underruns,
            is_complete=is_driven and not self._stop.is_set(),
            simulation_ended=self._clock.has_ended and not is_driven,
        )

    def _gone(self, error: can.CanError) -> BusError:
        return BusError(f"the bus went away after {self.sent} frames: {error}")

    def _send(self, message: can.Message) -> None:
        # Behind a frame that was given up each gets one attempt, until one passes: waiting would make all late.
        give_up_s = time.monotonic() + (0.0 if self._is_stuck else RETRY_FOR_S)
        while True:
            try:
                self._bus.send(message)
            except can.CanError as exc:
                if self._clock.has_ended:
                    return
                if exc.error_code in BUS_GONE:
                    raise self._gone(exc) from exc
                is_down = exc.error_code == errno.ENETDOWN
                self.interruptions += is_down and not self._is_down
                self._is_down |= is_down
                if is_down or time.monotonic() >= give_up_s:
                    self._is_stuck = True
                    self.given_up += 1
                    return
                self.retries += 1
                time.sleep(RETRY_PAUSE_S)
            else:
                self._is_stuck = self._is_down = False
                self.sent += 1
                return


def _next_chunk(ahead: "deque[Future[EncodedFrames | None]]", stop: threading.Event) -> EncodedFrames | None:
    """Wait for the next chunk; None at the end or when stopping. Raises what computing it raised."""
    while not stop.is_set():
        if wait(list(ahead)[:1], LONGEST_SLEEP_S).done:
            return ahead.popleft().result()
    return None


def transmit(
    bus: FrameSender,
    chunks: Iterable[EncodedFrames],
    stop: threading.Event,
    *,
    clock: SendClock | None = None,
    on_progress: Callable[[float, int], None] | None = None,
    ahead: int = CHUNKS_AHEAD,
) -> TransmitReport:
    """Send frames at the times they carry, from now on, until they end or ``stop`` is set.

    An interface that is down, bus-off or full loses the frames that are due meanwhile, which are counted; the rest
    follow when it is back. Raises BusError if the bus goes away for good.

    Parameters
    ----------
    bus : FrameSender
        Any open python-can bus, or what stands before one.
    chunks : iterable of EncodedFrames
        Frames in the order of their times; computed ahead in a thread.
    stop : threading.Event
        May be set by a signal handler.
    clock : SendClock
        In whose time they are due; this machine's by default.
    on_progress : callable
        Called with scenario time [s] and frames sent, about five times a second of this machine's time.
    ahead : int
        Chunks that are computed while one is sent.
    """
    clock = WallClock() if clock is None else clock
    transmitter, coming = _Transmitter(bus, clock, stop), iter(chunks)
    with ThreadPoolExecutor(1, "frame producer") as pool:
        computed = deque(pool.submit(next, coming, None) for _ in range(ahead))
        try:
            chunk = _next_chunk(computed, stop)
            started_s = clock.now_s() + clock.LEAD_IN_S
            next_progress_s = time.monotonic()
            while chunk is not None and not clock.has_ended:
                computed.append(pool.submit(next, coming, None))
                transmitter.send_chunk(chunk, started_s)
                if on_progress is not None and len(chunk) and time.monotonic() >= next_progress_s:
                    on_progress(float(chunk.t_s[-1]), transmitter.sent)
                    next_progress_s = time.monotonic() + PROGRESS_PERIOD_S
                is_ready = computed[0].done()
                chunk = _next_chunk(computed, stop)
                if chunk is not None and len(chunk) and not is_ready:
                    transmitter.underruns += clock.now_s() > started_s + float(chunk.t_s[0])
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    return transmitter.report(max(0.0, clock.now_s() - started_s), is_driven=chunk is None)


def to_messages(frames: EncodedFrames, epoch_s: float = 0.0) -> list[can.Message]:
    """Return frames as python-can takes them, with the times at which they are due; scenario time 0 is ``epoch_s``.

    A virtual bus may keep these times, so that what is heard there does not depend on how busy the machine is.
    """
    return [
        can.Message(
            timestamp=epoch_s + t_s,
            arbitration_id=can_id & ~(EXTENDED_FLAG | ERROR_FLAG),
            is_error_frame=bool(can_id & ERROR_FLAG),
            is_extended_id=bool(can_id & EXTENDED_FLAG),
            data=payload[:length].tobytes(),
        )
        for t_s, can_id, length, payload in zip(
            frames.t_s.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
        )
    ]


def open_bus(
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    *,
    fd: bool = False,
    options: Mapping[str, Any] = multicast.NOTHING,
) -> can.BusABC:
    """Open a bus; what is not given comes from CAN_INTERFACE, CAN_CHANNEL and can.conf, as with python-can's tools.

    ``udp_multicast`` keeps to this machine unless ``hop_limit`` is configured; ``options`` are more arguments of the
    driver, such as its port. Raises BusError if no bus is named, or it cannot be opened; the text says what to do.
    """
    try:
        settings = opening.complete_settings(interface, channel, bitrate, fd=fd)
        return pythoncan.open_bus(
            settings.interface, settings.channel, settings.bitrate, fd=settings.fd, options=options
        )
    except SourceError as exc:
        raise BusError(str(exc)) from exc
