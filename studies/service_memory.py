"""Memory of the live service over an hour of bus time: one recorded drive in a loop, faster than real time.

The command line's own ``run`` is at work, with its pipeline and its store on disk; only the bus is a double. Alive
counters and bus time go on from one round of the loop to the next.

    python -m studies.service_memory
"""

# ruff: noqa: E402 - what the live service leaves out must be left out before anything is imported

import asyncio
import gc
import json
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # as ``diag-service run`` does

import numpy as np
import psutil

from canlog.e2e.message_contract import message_contracts
from canlog.e2e.profile1 import protect
from canlog.frames import FrameBatch, join
from canlog.live import FrameSource, SourceCounts
from canlog.logs import read_log
from dbc.contract import load_contract
from diag_service import cli
from studies.run import parsed, study_parser

TARGET_MB = 300.0
SETTLED_S = 900.0  # caches and arenas have their size by then; from here on growth would be a leak
GROWTH_TARGET_MB_H = 5.0  # what the allocator's own unrest may look like
SAMPLE_PERIOD_S = 300.0
BATCH_NS = 50_000_000  # what a live source gathers
CYCLES = 3
NS_PER_S = 1_000_000_000
MB = 1e6
S_PER_H = 3600.0


class LoopedDrive:
    """A live source that plays a recorded drive again and again, with continuous bus time and alive counters.

    The drive is cut to whole seconds, of which every cycle time is a divisor, so rounds follow on each other in step.
    """

    def __init__(self, drive: FrameBatch, duration_s: float) -> None:
        self._round_ns = int(drive.t_ns[-1] - drive.t_ns[0]) // NS_PER_S * NS_PER_S
        self._drive = drive[: int(np.searchsorted(drive.t_ns, drive.t_ns[0] + self._round_ns))]
        self._duration_ns = round(duration_s * NS_PER_S)
        self._received = 0
        self._process = psutil.Process()
        self.samples: list[tuple[float, float]] = []  # bus time [s], resident memory [MB]

    description = "a recorded drive in a loop"

    @property
    def counts(self) -> SourceCounts:
        """What has been handed over."""
        return SourceCounts(received=self._received)

    async def __aiter__(self) -> AsyncIterator[FrameBatch]:
        """Iterate over batches as a live bus gives them, without waiting for it."""
        start_ns = int(self._drive.t_ns[0])
        next_sample_ns = 0
        for number in range(-(-self._duration_ns // self._round_ns)):
            for batch in self._batches(number):
                elapsed_ns = int(batch.t_ns[-1]) - start_ns
                if elapsed_ns >= self._duration_ns:
                    return
                if elapsed_ns >= next_sample_ns:
                    self.sample(elapsed_ns / NS_PER_S)
                    next_sample_ns += round(SAMPLE_PERIOD_S * NS_PER_S)
                self._received += len(batch)
                yield batch
                await asyncio.sleep(0)  # the outbox gets its turn

    async def aclose(self) -> None:
        """Nothing is open."""

    def sample(self, at_s: float) -> None:
        """Note the resident memory of this process."""
        self.samples.append((at_s, self._process.memory_info().rss / MB))

    def _batches(self, number: int) -> Iterator[FrameBatch]:
        frames = self._round(number)
        cuts = np.arange(frames.t_ns[0], frames.t_ns[-1], BATCH_NS)[1:]
        edges = [0, *np.unique(np.searchsorted(frames.t_ns, cuts)).tolist(), len(frames)]
        for first, stop in pairwise(edges):
            if stop > first:
                yield frames[first:stop]

    def _round(self, number: int) -> FrameBatch:
        """Return the drive at its later time; every message goes on counting."""
        data = self._drive.data.copy()
        for contract in message_contracts(load_contract()).values():
            rows = np.flatnonzero(self._drive.can_id == contract.can_id)
            if contract.data_id is not None:
                data[rows] = protect(data[rows], contract.data_id, number * len(rows) + np.arange(len(rows)))
        return FrameBatch(
            t_ns=self._drive.t_ns + number * self._round_ns,
            can_id=self._drive.can_id,
            length=self._drive.length,
            data=data,
        )


class DriveOpener:
    """Stands in for ``BusOpener``."""

    counts_duration = False

    def __init__(self, drive: LoopedDrive, *_settings: object, **_options: object) -> None:
        self._drive = drive

    async def open(self) -> FrameSource:
        """Return the drive."""
        return self._drive

    async def restart(self) -> str | None:
        """Refuse: it has no controller."""
        return "no controller"


def run_service(source: LoopedDrive) -> dict[str, object]:
    """Run ``diag-service run`` on a source until it ends; return the last record that it printed."""
    with (
        Path("out.jsonl").open("w", encoding="utf-8") as out,
        redirect_stdout(out),
        redirect_stderr(out),
        patch("diag_service.service.bus_run.BusOpener", partial(DriveOpener, source)),
    ):
        status = cli.main(["run", "--store", "results.sqlite", "--json"])
    said = Path("out.jsonl").read_text(encoding="utf-8").splitlines()
    if status != cli.EXIT_OK:
        raise SystemExit(f"diag-service ended with status {status}: {said[-1] if said else 'without a word'}")
    record: dict[str, object] = json.loads(said[-1])
    return record


def slope_mb_h(samples: list[tuple[float, float]]) -> float:
    """Return how fast memory grew once it had settled [MB/h], least squares; 0 if the run was too short to tell."""
    settled = [sample for sample in samples if sample[0] >= SETTLED_S]
    if len(settled) < 3:
        return 0.0
    at_s, size_mb = np.array(settled).T
    return float(np.polyfit(at_s / S_PER_H, size_mb, 1)[0])


def main() -> int:
    """Run the benchmark."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--hours", type=float, default=1.0, help="bus time (default: 1)")
    arguments = parsed(parser, hours=0.25)
    with TemporaryDirectory() as folder, chdir(folder):
        command = [sys.executable, "-m", "ecu_emulator", "record", "drive.log", "--cycles", str(CYCLES)]
        subprocess.run(command, check=True, capture_output=True)
        source = LoopedDrive(join(list(read_log("drive.log"))), arguments.hours * S_PER_H)
        began_s = time.perf_counter()
        summary = run_service(source)
        took_s = time.perf_counter() - began_s
        gc.collect()
        source.sample(arguments.hours * S_PER_H)
        store_mb = sum(path.stat().st_size for path in Path().glob("results.sqlite*")) / MB
    print(f"{arguments.hours:g} h of bus time through the live service in {took_s:.0f} s; store {store_mb:.1f} MB")
    print(f"  frames {summary['frames']}")
    print(f"  shifts {summary['shifts']}")
    print("  bus time [min]  " + " ".join(f"{at_s / 60.0:5.0f}" for at_s, _ in source.samples))
    print("  resident [MB]   " + " ".join(f"{size_mb:5.0f}" for _, size_mb in source.samples))
    largest_mb, growth_mb_h = max(size_mb for _, size_mb in source.samples), slope_mb_h(source.samples)
    size = "met" if largest_mb < TARGET_MB else "MISSED"
    growth = "met" if growth_mb_h < GROWTH_TARGET_MB_H else "MISSED"
    print(f"  largest {largest_mb:.0f} MB, target < {TARGET_MB:.0f} MB: {size}")
    print(
        f"  growth from minute {SETTLED_S / 60.0:.0f} on {growth_mb_h:+.1f} MB/h, "
        f"target < {GROWTH_TARGET_MB_H:.0f} MB/h: {growth}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
