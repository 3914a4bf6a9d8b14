"""A cluster beside processes of this machine, a few logs at a time in turns, so that what else is at work hits both.

Both have everything loaded. Of a cluster the workers, their guardian, the scheduler and the run count, of ``--jobs``
the processes and the run. ``benchmarks.cluster`` compares whole runs.

    python -m benchmarks.cluster_pairs --workers 2
"""

import argparse
import statistics
import time
from collections.abc import Iterable, Sequence
from dataclasses import astuple
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from benchmarks.cluster import Cost, cluster_of, make_logs
from benchmarks.measuring import machine
from clutch_model.calibration import nominal_calibration
from diag_service.lake.places import Place
from diag_service.lake.pools import ClusterAddress, ClusterPool, LocalPool, Pool
from diag_service.lake.run import Dispatch, find_logs
from diag_service.lake.work import Job, LakeLog
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig
from fleet_link import TlsFiles
from tests.support.cluster import Cluster

LOGS_EACH = 4  # of a turn, for each worker
TIME_LIMIT_S = 600.0
JOBS, CLUSTER = "--jobs", "cluster"


def families(cluster: Cluster) -> dict[str, set[psutil.Process]]:
    """Return the processes of both ways: the run itself has to do with either."""
    run = psutil.Process()
    programs = [psutil.Process(one.pid) for one in (cluster.scheduler, cluster.workers) if one is not None]
    theirs = {member for one in programs for member in (one, *one.children(recursive=True))}
    return {JOBS: {run, *run.children(recursive=True)} - theirs, CLUSTER: {run, *theirs}}


def busy_s(family: Iterable[psutil.Process]) -> float:
    """Return the processor time of some processes [s]."""
    times = [one.cpu_times() for one in family]
    return sum(one.user + one.system for one in times)


def turn(job: Job, pool: Pool, logs: Sequence[LakeLog], family: Iterable[psutil.Process]) -> Cost:
    """Return what it costs to have a pool analyse logs."""
    began, began_s = busy_s(family), time.monotonic()
    rows = list(Dispatch(job, pool, logs, Trigger()).rows())
    if reasons := [row.reason for row in rows if row.reason]:
        raise ValueError(reasons[0])
    return Cost(elapsed_s=time.monotonic() - began_s, processor_s=busy_s(family) - began)


def measured(folder: Path, workers: int, cycles: int, rounds: int) -> dict[str, list[Cost]]:
    """Return what each turn costs, by way."""
    make_logs(folder / "logs", LOGS_EACH * workers, cycles)
    lake = Place(str(folder / "lake"))
    logs = find_logs([str(folder / "logs")], lake, "car", has_vehicles=False)
    config = DiagnosisConfig(vehicle="car", calibration=nominal_calibration())
    job = Job.of(config, lake.address, None, TIME_LIMIT_S)
    with cluster_of(folder / "cluster", workers) as cluster:
        files = TlsFiles(authority=Path(cluster.tls[1]), certificate=Path(cluster.tls[3]), key=Path(cluster.tls[5]))
        pools: dict[str, Pool] = {
            JOBS: LocalPool(job, workers, is_shown=False),
            CLUSTER: ClusterPool(job, ClusterAddress.parse(cluster.address, files)),
        }
        for pool in pools.values():
            list(Dispatch(job, pool, [*logs, *logs], Trigger()).rows())  # every process has everything loaded
        family = families(cluster)
        found: dict[str, list[Cost]] = {way: [] for way in pools}
        for number in range(rounds):
            for way in (JOBS, CLUSTER) if number % 2 else (CLUSTER, JOBS):
                found[way].append(turn(job, pools[way], logs, family[way]))
        for pool in pools.values():
            pool.close()
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--cycles", type=int, default=10, help="of a log: ten shifts and 38 s each")
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args(arguments)
    print(machine())
    with TemporaryDirectory() as name:
        found = measured(Path(name), options.workers, options.cycles, options.rounds)
    count = LOGS_EACH * options.workers
    for way, costs in found.items():
        elapsed_s, processor_s = (statistics.median(kind) / count for kind in zip(*map(astuple, costs), strict=True))
        print(f"{way:>8} {options.workers}: {elapsed_s:.3f} s elapsed, {processor_s:.3f} s of a processor for each log")
    pairs = list(zip(found[CLUSTER], found[JOBS], strict=True))
    elapsed = statistics.median(ours.elapsed_s / theirs.elapsed_s for ours, theirs in pairs)
    processor = statistics.median(ours.processor_s / theirs.processor_s for ours, theirs in pairs)
    print(f"a cluster takes {elapsed - 1:+.1%} of the time and {processor - 1:+.1%} of the processor time more")
    print(f"  (medians of {len(pairs)} pairs; {count} logs of {options.cycles} cycles a turn)")


if __name__ == "__main__":
    main()
