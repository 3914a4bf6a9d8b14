"""Latency of the live service on a full bus: from the end of a shift to its stored and told result.

A drive in real time, with foreign traffic that fills a bus of 500 kbit/s, goes through the service's own queue, stages
and store on disk; only the socket is a double. A result cannot come before the signals that follow a shift are here.

    python -m benchmarks.live_latency
"""

import argparse
import asyncio
import sys
import tempfile
import threading
import time
from collections.abc import AsyncIterator
from contextlib import closing
from pathlib import Path

import numpy as np

from clutch_model.calibration import nominal_calibration
from dbc.contract import DBC_PATH
from diag_service.condition import ConditionMemory
from diag_service.database import load_database
from diag_service.estimation import Belief
from diag_service.frames import FrameBatch
from diag_service.live import run_live
from diag_service.mapping import Decoder
from diag_service.pipeline import Session, Stages, versions_for
from diag_service.profile import load_profile
from diag_service.publishers import MemoryReporter
from diag_service.records import Int64Array, ShiftResult
from diag_service.shifts import POST_NS
from diag_service.sources import SourceCounts
from diag_service.sources.columns import join
from diag_service.sources.frame_queue import FrameQueue
from diag_service.stopping import Trigger
from diag_service.store import ResultStore
from ecu_emulator.recording import Drive
from ecu_emulator.scenario_file import load_scenario

FULL_HZ = 3_850  # frames of eight bytes with their stuff bits, about 130 bits each, at 500 kbit/s
FOREIGN_ID = 0x7A0
WAKE_UP_S = 0.0025
TARGET_S = 0.2
CYCLE_S = 46.0
NS = 1e9


def full_bus(duration_s: float) -> FrameBatch:
    """Return a drive with as much foreign traffic as its bus can carry besides, in the order of time."""
    own = next(Drive(load_scenario("noise_only")).stretches(duration_s)).frames
    t_ns = np.rint(own.t_s * 1e6).astype(np.int64) * 1_000
    count = round(duration_s * FULL_HZ) - len(t_ns)
    times: Int64Array = np.concatenate((t_ns, np.linspace(0, t_ns[-1], count).astype(np.int64) // 1_000 * 1_000))
    order = np.argsort(times, kind="stable")
    return FrameBatch(
        t_ns=times[order],
        can_id=np.concatenate((own.can_id, np.full(count, FOREIGN_ID, np.uint32)))[order],
        length=np.concatenate((own.length, np.full(count, 8, np.uint8)))[order],
        data=np.concatenate((own.data[:, :8], np.zeros((count, 8), np.uint8)))[order],
    )


class PacedSource:
    """A bus whose frames come when they are due, from a thread of its own."""

    description = "paced"

    def __init__(self, frames: FrameBatch) -> None:
        self._frames = frames
        self._queue = FrameQueue()
        self._offered = 0
        self._is_over = threading.Event()
        self.began_s = time.monotonic()
        self._thread = threading.Thread(target=self._feed, name="bus")
        self._thread.start()

    @property
    def counts(self) -> SourceCounts:
        """What was offered and dropped."""
        return SourceCounts(received=self._offered, queue_dropped=self._queue.dropped)

    async def __aiter__(self) -> AsyncIterator[FrameBatch]:
        """Iterate over the batches."""
        while (batch := await self._queue.take()) is not None:
            if len(batch):
                yield batch

    async def aclose(self) -> None:
        """Fall silent."""
        self._is_over.set()
        await asyncio.to_thread(self._thread.join)

    def _feed(self) -> None:
        t_ns = self._frames.t_ns
        while self._offered < len(t_ns) and not self._is_over.wait(WAKE_UP_S):
            due = int(np.searchsorted(t_ns, t_ns[0] + (time.monotonic() - self.began_s) * NS, side="right"))
            self._queue.offer(self._frames[self._offered : due])
            self._offered = due
        self._queue.close()


class TimedReporter(MemoryReporter):
    """Notes when it is told of each result."""

    def __init__(self) -> None:
        super().__init__()
        self.told_s: list[float] = []

    def report(self, result: ShiftResult) -> None:
        """Note the moment."""
        self.told_s.append(time.monotonic())
        super().report(result)


async def run(frames: FrameBatch, store: ResultStore) -> tuple[list[float], SourceCounts]:
    """Run the service over the drive; return the latencies [s] and what became of the frames."""
    calibration = nominal_calibration()
    decoder = Decoder(load_database(DBC_PATH), load_profile())
    reporter = TimedReporter()
    session = Session(
        stages=Stages(decoder, calibration, Belief.fresh(calibration), ConditionMemory.fresh()),
        store=store,
        reporter=reporter,
        vehicle="benchmark",
        versions=versions_for(calibration, "benchmark"),
        stream=None,
        utc_now=lambda: "2026-01-01T00:00:00.000000Z",
    )
    source = PacedSource(frames)
    await run_live(source, session, stop=Trigger(), counts_wanted=Trigger(), outbox=None, duration_s=None)
    ends_s = [(result.estimate.end_ns - int(frames.t_ns[0])) / NS for result in reporter.results]
    latencies = [told - source.began_s - end for told, end in zip(reporter.told_s, ends_s, strict=True)]
    return latencies, source.counts


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=CYCLE_S, help=f"of driving (default: {CYCLE_S:g}, ten shifts)")
    frames = full_bus(parser.parse_args().seconds)
    warm = Decoder(load_database(DBC_PATH), load_profile())
    warm.feed(join([frames[:1_000]]))
    with tempfile.TemporaryDirectory() as folder, closing(ResultStore.open(Path(folder) / "car.sqlite")) as store:
        latencies, counts = asyncio.run(run(frames, store))
    p50, p99 = np.percentile(latencies, [50, 99])
    rate_hz = len(frames) / (np.ptp(frames.t_ns) / NS)
    print(f"Result after the end of a shift, {rate_hz:.0f} frames/s, {len(latencies)} shifts")
    print(f"  waits for what follows the shift     {1e3 * POST_NS / NS:6.0f} ms")
    print(f"  median {1e3 * p50:.0f} ms, p99 {1e3 * p99:.0f} ms, of {len(latencies)}")
    print(f"  frames dropped                       {counts.queue_dropped:6d} of {counts.received}")
    print(f"  target p99 < {1e3 * TARGET_S:.0f} ms: {'met' if p99 < TARGET_S else 'MISSED'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
