"""Many logs into a lake by one process, by two, and by a cluster of one and of two workers: time and memory.

python -m benchmarks.cluster --logs 200 --cycles 10
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from benchmarks.measuring import machine, processor_s
from tests.support.cluster import Cluster
from tests.support.service import PROGRAM, environment

MEMORY_MIB = 700
WORKERS = (1, 2)
FEW = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a run takes."""

    elapsed_s: float
    processor_s: float

    def __sub__(self, other: "Cost") -> "Cost":
        return Cost(elapsed_s=self.elapsed_s - other.elapsed_s, processor_s=self.processor_s - other.processor_s)

    def against(self, other: "Cost") -> str:
        """Return by how much this is more than another."""
        shares = self.elapsed_s / other.elapsed_s - 1, self.processor_s / other.processor_s - 1
        return f"elapsed {shares[0]:+.1%}, processor {shares[1]:+.1%}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Runs:
    """What a run of few logs takes, nearly all of it start and end, and one of all logs."""

    few: Cost
    many: Cost

    @property
    def logs(self) -> Cost:
        """What the further logs take."""
        return self.many - self.few


def least(costs: Sequence[Cost]) -> Cost:
    """Return the least times of several rounds."""
    return Cost(elapsed_s=min(one.elapsed_s for one in costs), processor_s=min(one.processor_s for one in costs))


def make_logs(folder: Path, count: int, cycles: int) -> float:
    """Write logs of two lengths, each begun a little later so that all differ; return their size [MB]."""
    whole = folder.parent / "whole.log"
    command = [sys.executable, "-m", "ecu_emulator", "record", str(whole), "--cycles", str(cycles)]
    subprocess.run(command, check=True, capture_output=True)
    lines = whole.read_bytes().splitlines(keepends=True)
    folder.mkdir()
    for number in range(count):
        part = lines[number : len(lines) if number % 4 else len(lines) // 2]
        (folder / f"drive{number:03}.log").write_bytes(b"".join(part))
    return sum(path.stat().st_size for path in folder.iterdir()) / 1e6


def ran(words: Sequence[str], cluster: Cluster | None = None) -> Cost:
    """Return what a run costs, with what its cluster has to do with it."""
    began, began_s = processor_of(cluster), time.monotonic()
    subprocess.run([*PROGRAM, "analyze", *words], check=True, capture_output=True, env=environment())
    return Cost(elapsed_s=time.monotonic() - began_s, processor_s=processor_of(cluster) - began)


def processor_of(cluster: Cluster | None) -> float:
    """Return the processor time of all runs until now, and of a cluster [s]."""
    total_s = processor_s()
    for program in () if cluster is None else (cluster.scheduler, cluster.workers):
        if program is not None:
            whole = psutil.Process(program.pid)
            times = [one.cpu_times() for one in (whole, *whole.children(recursive=True))]
            total_s += sum(one.user + one.system for one in times)
    return total_s


@contextmanager
def cluster_of(folder: Path, workers: int) -> Iterator[Cluster]:
    """Run a cluster whose workers have analysed something before: what is compared is their work, not their start."""
    folder.mkdir()
    with Cluster(folder) as cluster:
        cluster.start_scheduler()
        cluster.start_workers("--jobs", str(workers), "--memory", str(MEMORY_MIB))
        yield cluster


def peak_mib(cluster: Cluster) -> float:
    """Return the largest memory that a worker of a cluster has had [MiB]."""
    if cluster.workers is None:
        return 0.0
    family = psutil.Process(cluster.workers.pid).children(recursive=True)
    peaks = [0.0]
    for one in family:
        status = Path(f"/proc/{one.pid}/status").read_text(encoding="ascii")
        peaks += [int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM:")]
    return max(peaks)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print: what many logs cost, and what they cost more than few, so that no start is compared."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--cycles", type=int, default=10, help="of a log: ten shifts and 38 s each")
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args(arguments)
    print(machine())
    with TemporaryDirectory() as name:
        folder = Path(name)
        size_mb = make_logs(folder / "logs", options.logs, options.cycles)
        (folder / "few").mkdir()
        make_logs(folder / "few" / "logs", FEW, options.cycles)
        print(f"{options.logs} logs, {size_mb:.0f} MB, load {os.getloadavg()[0]:.1f}")
        rounds = [measured(folder, number) for number in range(options.rounds)]
    best = {
        what: Runs(few=least([one[what].few for one in rounds]), many=least([one[what].many for one in rounds]))
        for what in rounds[0]
    }
    report(best, options.logs)


def report(best: Mapping[tuple[str, int], Runs], count: int) -> None:
    """Print what every way takes, and what a cluster takes more than processes of this machine."""
    print(f"elapsed, processor [s]       {count - FEW} logs more         {count} logs   {FEW} logs, start and end")
    for (way, workers), runs in best.items():
        shown = (f"{one.elapsed_s:7.1f} {one.processor_s:7.1f}" for one in (runs.logs, runs.many, runs.few))
        print(f"{way:>8} of {workers}    {'    '.join(shown)}")
    speed_up = best["cluster", 1].logs.elapsed_s / best["cluster", 2].logs.elapsed_s
    print(f"two workers against one: {speed_up:.2f} times as fast")
    for workers, way in product(WORKERS, ("lake", "table")):
        ours, theirs = best["cluster", workers], best[way, workers]
        print(f"{workers} in a cluster against --jobs {workers} into a {way}:")
        print(f"  without start and end {ours.logs.against(theirs.logs)}; with them {ours.many.against(theirs.many)}")


def measured(folder: Path, number: int) -> dict[tuple[str, int], Runs]:
    """Return what every way costs, in turns."""
    found: dict[tuple[str, int], Runs] = {}
    many, few = str(folder / "logs"), str(folder / "few" / "logs")
    for workers in WORKERS:
        own = folder / f"{number}-{workers}"
        own.mkdir()
        jobs = ("--jobs", str(workers))
        for way, option, suffix in (("table", "-o", ".parquet"), ("lake", "--lake", "")):
            start = ran([few, option, str(own / f"{way}-few{suffix}"), *jobs])
            whole = ran([many, option, str(own / f"{way}-many{suffix}"), *jobs])
            found[way, workers] = Runs(few=start, many=whole)
        with cluster_of(own / "cluster", workers) as cluster:
            words = ("--scheduler", cluster.address, *cluster.tls)
            ran([few, "--lake", str(own / "first"), *words])  # every worker has everything loaded
            start = ran([few, "--lake", str(own / "few"), *words], cluster)
            whole = ran([many, "--lake", str(own / "many"), *words], cluster)
            found["cluster", workers] = Runs(few=start, many=whole)
            print(f"largest memory of a worker of {workers}: {peak_mib(cluster):.0f} MiB", flush=True)
    return found


if __name__ == "__main__":
    main()
