"""How a live run stands at one moment, for whoever looks on: monitor, metrics, watchdog."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from canlog.live import BusState, BusStatus, LiveSource
from canlog.traffic import DEFAULT_BITRATE
from clutch_model.units import NS_PER_S
from clutch_results.records import FluidFill, ShiftResult
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Summary
from diag_service.mapping.decoder import MessageCounts
from diag_service.service.session import Session, Stuck
from diag_service.service.stages import Stages

STALE_S = 5.0  # a service that has not looked up for this long does not live
READY_STATES = frozenset({BusState.UP, BusState.DEGRADED})
RATE_SPAN_S = 1.0
SILENT_S = 2.0  # more than frames gather for: a bus of which nothing was counts for so long says nothing


class WatchedSource(LiveSource, Protocol):
    """A live bus whose state and load are known."""

    @property
    def status(self) -> BusStatus:
        """State of the bus and what has happened to it."""

    @property
    def bit_count(self) -> float:
        """Bits on the bus that the frames counts stand for, stuff bits estimated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """Everything that can be seen of a live run."""

    taken_s: float  # monotonic
    bus: BusStatus
    clock_steps: int  # of the wall clock, taken out of bus time
    load_ratio: float  # share of the bit rate that the frames took, stuff bits estimated
    messages: Mapping[str, MessageCounts]
    rates_hz: Mapping[str, float]  # of messages, as received
    summary: Summary
    recent: tuple[ShiftResult, ...]  # oldest first
    stuck: Stuck | None  # a stage that makes no progress
    clutches: tuple[ShiftResult, ...]  # the last result of each clutch, clutch 1 first; earlier runs count
    fluid: FluidFill | None  # the present one, if its fill is known


def frame_counts(source: LiveSource, stages: Stages) -> FrameCounts:
    """Return what became of the frames of a live bus."""
    counts = source.counts
    return replace(
        stages.decoder.counts,
        on_bus=counts.received + counts.kernel_dropped,
        unsupported=counts.unsupported,
        kernel_dropped=counts.kernel_dropped,
        queue_dropped=counts.queue_dropped,
    )


class RateMeter:
    """Frames and bits per second over the time since the last measurement, ``RATE_SPAN_S`` at least.

    They are counted over the bus time of what was counts: frames come in batches, and the clock goes on between them.
    """

    def __init__(self, now_s: float, bitrate: int) -> None:
        self._since_s = now_s
        self._seen_ns: int | None = None
        self._bitrate = bitrate
        self._bits = 0.0
        self._received: Mapping[str, int] = {}
        self.load_ratio = 0.0
        self.rates_hz: Mapping[str, float] = {}

    def measure(self, now_s: float, seen_ns: int | None, received: Mapping[str, int], bits: float) -> None:
        """Take new rates once there is something new.

        ``seen_ns`` is the bus time of the last frame, None before the first; ``received`` and ``bits`` count the frames
        by message, and the bits on the bus, until ``now_s`` (monotonic).
        """
        span_s = now_s - self._since_s
        step_ns = 0 if seen_ns is None or self._seen_ns is None else seen_ns - self._seen_ns
        if span_s < RATE_SPAN_S or (seen_ns == self._seen_ns is not None and span_s < SILENT_S):
            return
        # Bus time that went too far is that of another stretch.
        over_s = step_ns / NS_PER_S if 0 < step_ns <= 2.0 * span_s * NS_PER_S else span_s
        self.rates_hz = {name: (count - self._received.get(name, 0)) / over_s for name, count in received.items()}
        self.load_ratio = (bits - self._bits) / over_s / self._bitrate
        self._since_s, self._seen_ns, self._bits, self._received = now_s, seen_ns, bits, received


class SnapshotTaker:
    """Takes snapshots of a run."""

    def __init__(self, source: WatchedSource, session: Session, now_s: float, bitrate: int | None) -> None:
        self._source = source
        self._session = session
        self._meter = RateMeter(now_s, bitrate or DEFAULT_BITRATE)

    def snapshot(self, now_s: float) -> Snapshot:
        """Return how things stand; ``now_s`` is monotonic."""
        decoder = self._session.stages.decoder
        messages = decoder.messages
        received = {name: counts.decoded + sum(counts.rejected.values()) for name, counts in messages.items()}
        self._meter.measure(now_s, decoder.last_ns, received, self._source.bit_count)
        return Snapshot(
            taken_s=now_s,
            bus=self._source.status,
            clock_steps=self._source.counts.clock_steps,
            load_ratio=self._meter.load_ratio,
            messages=messages,
            rates_hz={name: self._meter.rates_hz.get(name, 0.0) for name in messages},
            summary=self._session.summary(frame_counts(self._source, self._session.stages), None),
            recent=self._session.statistics.recent,
            stuck=self._session.progress.stuck,
            clutches=self._session.latest,
            fluid=self._session.fluid,
        )


class Board:
    """The latest snapshot, which the service replaces and other threads read."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self.latest: Snapshot | None = None

    @property
    def is_live(self) -> bool:
        """Whether the latest snapshot is recent and no stage is stuck."""
        latest = self.latest
        return latest is not None and latest.stuck is None and self._now_s() - latest.taken_s < STALE_S

    @property
    def is_ready(self) -> bool:
        """Whether it is live and its bus is up."""
        return self.is_live and self.latest is not None and self.latest.bus.state in READY_STATES
