"""A lake made by a cluster whose parts are killed at random, in a store that refuses and stalls: every log once.

python -m tests.tools.cluster_chaos --kills 20 --logs 40
"""

import argparse
import io
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil
import pyarrow.parquet as pq

from diag_service.lake.parts import DONE, Manifest, disagreement
from diag_service.lake.places import Place
from tests.plugins.drives import SHIFT_COUNT, send_time_s
from tests.support.cluster import Cluster
from tests.support.lakes.fault_proxy import Fault, FaultProxy
from tests.support.lakes.greedy import GREEDY
from tests.support.s3 import BUCKET, in_environment, s3_environment, s3_server, store
from tests.support.service import PROGRAM, environment

POLL_S = 0.1
KILL_AFTER_S = (0.0, 4.0)  # of a log that was done: kills hit work, not processes that start
PATIENCE_S = 30.0  # with processes that do no log
FAULT_EVERY_S = (0.5, 3.0)
RUN_LIMIT_S = 3000.0
MEMORY_MIB = "700"
GREEDY_PROGRAM = (sys.executable, "-m", "tests.support.lakes.greedy")
LOGS, LAKE = f"s3://{BUCKET}/logs", f"s3://{BUCKET}/lake"


@dataclass
class Storm:
    """Kills and faults until there were enough kills, and runs that are started again until one has done everything."""

    cluster: Cluster
    proxy: FaultProxy
    folder: Path
    rng: random.Random
    killed: Counter[str] = field(default_factory=Counter)
    runs: int = 0
    _seen_count: int = 0

    def fill(self, kills: int) -> None:
        """Make the lake, however often the run is killed; at least so many kills happen if it takes long enough."""
        began_s = time.monotonic()
        run = self._run()
        kill_at_s = self._next_kill_s()
        fault_at_s = time.monotonic()
        while True:
            if time.monotonic() - began_s > RUN_LIMIT_S:
                raise TimeoutError(f"not done after {RUN_LIMIT_S:g} s: {self._said()}")
            self._keep_alive()
            is_stormy = self.killed.total() < kills
            if kill_at_s > time.monotonic() and self._done_count() > self._seen_count:
                kill_at_s = min(kill_at_s, time.monotonic() + self.rng.uniform(*KILL_AFTER_S))
                self._seen_count = self._done_count()
            if is_stormy and time.monotonic() >= kill_at_s:
                self._kill(run)
                kill_at_s = self._next_kill_s()
            if time.monotonic() >= fault_at_s:
                self.proxy.fault = self.rng.choice(list(Fault)) if kills else Fault.NONE
                fault_at_s = time.monotonic() + self.rng.uniform(*FAULT_EVERY_S)
            if run.poll() is not None:
                if run.returncode == 0:
                    return
                run = self._run()
            time.sleep(POLL_S)

    def _next_kill_s(self) -> float:
        self._seen_count = self._done_count()
        return time.monotonic() + PATIENCE_S

    def _done_count(self) -> int:
        said = self.folder / "run.txt"
        return said.read_text(encoding="utf-8").count(" shifts\n") if said.exists() else 0

    def _run(self) -> subprocess.Popen[bytes]:
        self.runs += 1
        words = ("analyze", LOGS, "--lake", LAKE, "--vehicle-from", "path", "--scheduler", self.cluster.address)
        with (self.folder / "run.txt").open("ab") as said:
            command = [*PROGRAM, *words, *self.cluster.tls]
            return subprocess.Popen(command, stdout=said, stderr=said, env=environment())

    def _keep_alive(self) -> None:
        """Start what has ended, as a supervisor does."""
        if self.cluster.scheduler is None or self.cluster.scheduler.poll() is not None:
            self.cluster.start_scheduler()
        if self.cluster.workers is None or self.cluster.workers.poll() is not None:
            self.cluster.start_workers("--jobs", "2", "--memory", MEMORY_MIB)

    def _kill(self, run: subprocess.Popen[bytes]) -> None:
        what = self.rng.choice(("worker", "worker", "guardian", "scheduler", "scheduler", "run"))
        if what == "worker" and self.cluster.workers is not None:
            family = psutil.Process(self.cluster.workers.pid).children(recursive=True)
            workers = [one for one in family if "spawn_main" in " ".join(one.cmdline())]
            if not workers:
                return
            self.rng.choice(workers).kill()
        elif what == "guardian":
            self.cluster.kill(self.cluster.workers)
        elif what == "scheduler" and self.cluster.scheduler is not None:
            self.cluster.scheduler.send_signal(signal.SIGKILL)
            self.cluster.scheduler.wait()
        else:
            run.send_signal(signal.SIGKILL)
            run.wait()
        self.killed[what] += 1

    def _said(self) -> str:
        return (self.folder / "run.txt").read_text(encoding="utf-8")[-2000:]


def upload(files: Any, log: Path, numbers: range) -> list[str]:  # noqa: ANN401 - an untyped library
    """Put logs into the store, each begun a little later so that all differ; return their addresses."""
    lines = log.read_bytes().splitlines(keepends=True)
    names = [f"{BUCKET}/logs/car{number % 3}/drive{number:03}.log" for number in numbers]
    for number, name in zip(numbers, names, strict=True):
        files.pipe_file(name, b"".join(lines[number:]))
    return [f"s3://{name}" for name in names]


def faults(files: Any, logs: Sequence[str], shift_count: int) -> list[str]:  # noqa: ANN401 - likewise
    """Return what is wrong with the lake."""
    wrong = list[str]()
    place = Place(LAKE)
    rows = Manifest(place).rows
    done = {row.source for row in rows if row.outcome == DONE}
    failed = {row.source: row.reason for row in rows if row.outcome != DONE}
    wrong += [f"missing: {log}" for log in logs if log not in done]
    shifts: Counter[tuple[str, int]] = Counter()
    of_log: Counter[str] = Counter()
    for name in files.glob(f"{BUCKET}/lake/shifts/*/*/*.parquet"):
        columns = ["path", "stream", "seq"]
        for row in pq.ParquetFile(io.BytesIO(files.cat_file(name))).read(columns, use_threads=False).to_pylist():
            shifts[row["stream"], row["seq"]] += 1
            of_log[row["path"]] += 1
    wrong += [f"twice: {key}" for key, count in shifts.items() if count > 1]
    wrong += [f"{of_log[log]} shifts: {log}" for log in logs if of_log[log] != shift_count]
    found = disagreement(place)
    wrong += [f"{found}"] if found.missing or found.unknown or found.twice else []
    reasons = {name.rsplit("/", 1)[-1]: reason for name, reason in failed.items()}
    for name, text in {
        "bad.blf": "no CAN frame",
        "notes.txt": "not a log",
        f"{GREEDY}.log": "its process died",
    }.items():
        wrong += [f"{name}: {reasons.pop(name, None)}"] if text not in reasons.get(name, "") else []
        reasons.pop(name, None)
    return [*wrong, *(f"failed: {name}: {reason}" for name, reason in reasons.items())]


def main(arguments: Sequence[str] | None = None) -> int:
    """Do it and print what was found; the status is 0 if every log is in the lake once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--logs", type=int, default=40, help="at a time, until there were so many kills")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as name, s3_server() as port, FaultProxy(port) as proxy:
        folder = Path(name)
        log = folder / "cycle.log"
        command = [sys.executable, "-m", "ecu_emulator", "record", str(log), "--cycles", "1"]
        subprocess.run(command, check=True, capture_output=True)
        lines = log.read_bytes().splitlines(keepends=True)
        begun_s = send_time_s(lines[0])
        log.write_bytes(b"".join(line for line in lines if send_time_s(line) < begun_s + 12.0))
        with in_environment(s3_environment(proxy.port)):
            variables = s3_environment(proxy.port)
            with Cluster(folder, variables, GREEDY_PROGRAM) as cluster:
                return storm(cluster, proxy, folder, log, port, options)


def storm(cluster: Cluster, proxy: FaultProxy, folder: Path, log: Path, port: int, options: argparse.Namespace) -> int:
    """Let the storm pass and print what it left."""
    files = store(port)
    files.pipe_file(f"{BUCKET}/logs/car0/bad.blf", b"LOGG" + bytes(200))
    files.pipe_file(f"{BUCKET}/logs/car1/notes.txt", b"not a log\n")
    files.pipe_file(f"{BUCKET}/logs/car2/{GREEDY}.log", log.read_bytes())
    weather = Storm(cluster, proxy, folder, random.Random(options.seed))  # noqa: S311 - no secret
    began_s = time.monotonic()
    logs = list[str]()
    while weather.killed.total() < options.kills:
        logs += upload(files, log, range(len(logs), len(logs) + options.logs))
        weather.fill(options.kills)
        print(f"{len(logs)} logs, killed {dict(weather.killed)}, {time.monotonic() - began_s:.0f} s", flush=True)
    weather.fill(0)
    with in_environment(s3_environment(port)):
        before = files.find(f"{BUCKET}/lake", detail=True)
        weather.fill(0)
        is_same = {name: one["ETag"] for name, one in files.find(f"{BUCKET}/lake", detail=True).items()} == {
            name: one["ETag"] for name, one in before.items()
        }
        wrong = faults(files, logs, SHIFT_COUNT)
    print(f"{len(logs)} logs and 3 that cannot be analysed; killed: {dict(weather.killed)}; runs: {weather.runs}")
    print(f"the store refused {proxy.refused} times and kept {proxy.delayed} blocks waiting")
    print(f"a run more {'did nothing' if is_same else 'changed the lake'}")
    print(f"wrong: {len(wrong)}")
    print("".join(f"  {one}\n" for one in wrong[:20]), end="")
    return 1 if wrong or not is_same else 0


if __name__ == "__main__":
    raise SystemExit(main())
