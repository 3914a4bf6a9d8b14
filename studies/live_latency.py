"""Latency of the live service on a full bus: from the end of a shift to its stored and told result.

A drive in real time, with foreign traffic that fills a bus of 500 kbit/s, goes through the service's own queue, stages
and store on disk; only the socket is a double, which gathers frames as the service's own does. A result cannot come
before the signals that follow a shift are here.

    python -m studies.live_latency --shifts 100
"""

import asyncio
import math
import os
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from canlog.frames import FrameBatch
from canlog.live import ReadSchedule, SourceCounts
from canlog.live.sources import FrameQueue
from clutch_model.calibration import nominal_calibration
from clutch_results.records import ShiftResult
from diag_service.delivery import MemoryReporter, News
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.shifts import POST_NS
from diag_service.service.live import run_live
from diag_service.service.session import Session
from diag_service.settings.config import DiagnosisConfig
from diag_service.stopping import Trigger
from diag_service.store import ResultStore
from ecu_emulator.drive.recording import Drive
from ecu_emulator.scenario.scenario_file import load_scenario
from studies.builders import new_decoder, new_stages
from studies.run import parsed, study_parser

FULL_HZ = 3_850  # frames of eight bytes with their stuff bits, about 130 bits each, at 500 kbit/s
FOREIGN_ID = 0x7A0
CYCLE_S = 46.0
CYCLE_SHIFTS = 10
WARM_UP_S = 8.0  # one shift
NS = 1e9


def full_bus(duration_s: float) -> FrameBatch:
    """Return a drive with as much foreign traffic as its bus can carry besides, in the order of time."""
    cycles = math.ceil(duration_s / CYCLE_S)
    own = next(Drive(replace(load_scenario("noise_only"), cycles=cycles)).stretches(duration_s)).frames
    t_ns = np.rint(own.t_s * 1e6).astype(np.int64) * 1_000
    count = round(duration_s * FULL_HZ) - len(t_ns)
    times = np.concatenate((t_ns, np.linspace(0, t_ns[-1], count).astype(np.int64) // 1_000 * 1_000))
    order = np.argsort(times, kind="stable")
    return FrameBatch(
        t_ns=times[order],
        can_id=np.concatenate((own.can_id, np.full(count, FOREIGN_ID, np.uint32)))[order],
        length=np.concatenate((own.length, np.full(count, 8, np.uint8)))[order],
        data=np.concatenate((own.data[:, :8], np.zeros((count, 8), np.uint8)))[order],
    )


class PacedSource:
    """A bus whose frames come when they are due, looked at when the schedule says."""

    description = "paced"

    def __init__(self, frames: FrameBatch, schedule: ReadSchedule) -> None:
        self._frames = frames
        self._schedule = schedule
        self._queue = FrameQueue(linger_s=0.0)
        self._offered = 0
        self._is_over = False
        self._news = asyncio.Event()
        schedule.on_change = self._news.set
        self.began_s = time.monotonic()
        self._feeding = asyncio.create_task(self._feed())

    @property
    def counts(self) -> SourceCounts:
        """What was offered and dropped."""
        return SourceCounts(received=self._offered, queue_dropped=self._queue.dropped)

    async def __aiter__(self) -> AsyncIterator[FrameBatch]:
        """Iterate over the batches."""
        while (batch := await self._queue.next_batch()) is not None:
            if len(batch):
                yield batch

    async def aclose(self) -> None:
        """Fall silent."""
        self._is_over = True
        self._news.set()
        await self._feeding

    async def _feed(self) -> None:
        t_ns = self._frames.t_ns
        while self._offered < len(t_ns) and not self._is_over:
            await self._gather()
            due = int(np.searchsorted(t_ns, t_ns[0] + (time.monotonic() - self.began_s) * NS, side="right"))
            self._queue.offer(self._frames[self._offered : due])
            self._offered = due
        self._queue.close()

    async def _gather(self) -> None:
        """Let frames gather for as long as the schedule says, which may change meanwhile."""
        gathered_s = time.monotonic()
        seen_ns = int(self._frames.t_ns[self._offered - 1]) if self._offered else None
        while not self._is_over and (left_s := gathered_s + self._schedule.gather_s(seen_ns) - time.monotonic()) > 0.0:
            self._news.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(left_s):
                    await self._news.wait()


class TimedSession(Session):
    """Notes how long it takes to process each shift, and the processor time of that."""

    processed_s: list[tuple[float, float]]

    def process(self, event: Event) -> None:
        """Note the time."""
        began_s, cpu_s = time.monotonic(), time.thread_time()
        super().process(event)
        self.processed_s.append((time.monotonic() - began_s, time.thread_time() - cpu_s))


class TimedReporter(MemoryReporter):
    """Notes when it is told of each result."""

    def __init__(self) -> None:
        super().__init__()
        self.told_s: list[float] = []

    def report(self, news: News) -> None:
        """Note the moment."""
        if isinstance(news, ShiftResult):
            self.told_s.append(time.monotonic())
        super().report(news)


async def run(frames: FrameBatch, store: ResultStore) -> tuple[list[float], list[tuple[float, float]], SourceCounts]:
    """Run the service over the drive; return latencies and parts of settling [s], and what became of the frames."""
    reporter = TimedReporter()
    config = DiagnosisConfig(vehicle="study", calibration=nominal_calibration())
    session = TimedSession(config, new_decoder(), store, None, reporter)
    session.processed_s = []
    schedule = ReadSchedule()
    source = PacedSource(frames, schedule)
    await run_live(
        source, session, stop=Trigger(), counts_wanted=Trigger(), outbox=None, duration_s=None, schedule=schedule
    )
    ends_s = [(result.estimate.end_ns - int(frames.t_ns[0])) / NS for result in reporter.results]
    latencies = [told - source.began_s - end for told, end in zip(reporter.told_s, ends_s, strict=True)]
    return latencies, session.processed_s, source.counts


def warm_up() -> None:
    """Have everything compiled by a short drive, as it is in a service that ran before."""
    new_stages().feed(full_bus(WARM_UP_S))


def main() -> int:
    """Run the benchmark."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--shifts", type=int, default=CYCLE_SHIFTS, help=f"a multiple of {CYCLE_SHIFTS}, the default")
    frames = full_bus(CYCLE_S * parsed(parser).shifts / CYCLE_SHIFTS)
    warm_up()
    with tempfile.TemporaryDirectory() as folder, closing(ResultStore.open(Path(folder) / "car.sqlite")) as store:
        latencies, processed, counts = asyncio.run(run(frames, store))
    p50, p99 = np.percentile(latencies, [50, 99])
    rate_hz = len(frames) / (np.ptp(frames.t_ns) / NS)
    print(f"Result after the end of a shift, {rate_hz:.0f} frames/s, {len(latencies)} shifts")
    print(f"  waits for what follows the shift     {1e3 * POST_NS / NS:6.0f} ms")
    wall_ms, cpu_ms = 1e3 * np.array(processed).T
    print(f"  estimates, stores, tells: median     {np.median(wall_ms):6.0f} ms, most {wall_ms.max():.0f} ms")
    print(f"    processor time of that             {np.median(cpu_ms):6.0f} ms, most {cpu_ms.max():.0f} ms")
    print(f"  median {1e3 * p50:.0f} ms, p99 {1e3 * p99:.0f} ms, most {1e3 * max(latencies):.0f} ms")
    print(f"  frames dropped                       {counts.queue_dropped:6d} of {counts.received}")
    if (load := os.getloadavg()[0] / (os.cpu_count() or 1)) > 1.0:
        print(f"  a busy machine: load {load:.1f} per core")
    return 0


if __name__ == "__main__":
    sys.exit(main())
