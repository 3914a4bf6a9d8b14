"""Many logs into a lake by one process, by two, and by a cluster of one and of two workers: time and memory.

python -m benchmarks.cluster --logs 200 --cycles 3
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from benchmarks.measuring import machine
from tests.support.cluster import Cluster
from tests.support.service import PROGRAM, environment

MEMORY_MIB = 700
WORKERS = (1, 2)


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


def filled_s(logs: Path, lake: Path, *words: str) -> float:
    """Return how long a run takes from start to end [s]."""
    began_s = time.monotonic()
    command = [*PROGRAM, "analyze", str(logs), "--lake", str(lake), *words]
    subprocess.run(command, check=True, capture_output=True, env=environment())
    return time.monotonic() - began_s


def table_s(logs: Path, output: Path, jobs: int) -> float:
    """Return how long the run over a folder into one table takes [s]."""
    began_s = time.monotonic()
    command = [*PROGRAM, "analyze", str(logs), "-o", str(output), "--jobs", str(jobs), "--force"]
    subprocess.run(command, check=True, capture_output=True, env=environment())
    return time.monotonic() - began_s


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
    """Measure and print; every line of the table is measured as often, in turns."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--cycles", type=int, default=3, help="of a log: ten shifts each")
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args(arguments)
    print(machine())
    with TemporaryDirectory() as name:
        folder = Path(name)
        size_mb = make_logs(folder / "logs", options.logs, options.cycles)
        (folder / "few").mkdir()
        make_logs(folder / "few" / "logs", 4, 1)
        print(f"{options.logs} logs, {size_mb:.0f} MB, load {os.getloadavg()[0]:.1f}")
        rounds = [measured(folder, number) for number in range(options.rounds)]
    best = {what: min(one[what] for one in rounds) for what in rounds[0]}
    for what, value in best.items():
        print(f"{what:<44}{value:8.1f}")
    print(
        f"two workers against one: {best['cluster, 1 worker [s]'] / best['cluster, 2 workers [s]']:.2f} times as fast"
    )
    for workers in WORKERS:
        plural = "s" if workers > 1 else ""
        ratio = best[f"cluster, {workers} worker{plural} [s]"]
        against_lake = ratio / best[f"lake, --jobs {workers} [s]"] - 1.0
        against_table = ratio / best[f"table, --jobs {workers} [s]"] - 1.0
        print(f"{workers} worker{plural}: {against_lake:+.1%} against --jobs into a lake, {against_table:+.1%} a table")


def measured(folder: Path, number: int) -> dict[str, float]:
    """Return one figure for every way."""
    found: dict[str, float] = {}
    logs, few = folder / "logs", folder / "few" / "logs"
    for workers in WORKERS:
        plural = "s" if workers > 1 else ""
        found[f"table, --jobs {workers} [s]"] = table_s(logs, folder / f"{number}-{workers}.parquet", workers)
        found[f"lake, --jobs {workers} [s]"] = filled_s(
            logs, folder / f"local{number}-{workers}", "--jobs", str(workers)
        )
        with cluster_of(folder / f"cluster{number}-{workers}", workers) as cluster:
            words = ("--scheduler", cluster.address, *cluster.tls)
            filled_s(few, folder / f"warm{number}-{workers}", *words)
            found[f"cluster, {workers} worker{plural} [s]"] = filled_s(logs, folder / f"lake{number}-{workers}", *words)
            found[f"peak of a worker of {workers} [MiB]"] = peak_mib(cluster)
        (folder / f"{number}-{workers}.parquet.journal").unlink()
    return found


if __name__ == "__main__":
    main()
