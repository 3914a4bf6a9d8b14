"""The whole suite, several times: each time in another order, some times on one core or beside busy loops.

    python -m tests.tools.suite_runs 11 12 13:one-core 14:one-core 15:busy 16:busy --folder /tmp/suite-runs

A run is the number of its order and, after a colon, what it is run under:

- `one-core`: everything on the first core alone
- `busy`: four loops beside it that never rest (`--loops` for more)
- `one-core-busy`: both, the loops on that core, too

Each run is `make test-both ORDER=number` (`--target test` for all that CI runs, the static checks included). What it
says goes into a file of the folder as it comes; the table is printed and written anew after every run. Ctrl-C and
SIGTERM end what has begun, and the table keeps the runs that were done.
"""

import argparse
import contextlib
import dataclasses
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Final

import psutil

REPOSITORY = Path(__file__).parents[2]
IDLE, ONE_CORE, BUSY, ONE_CORE_BUSY = CONDITIONS = "idle", "one-core", "busy", "one-core-busy"
FIRST_CORE: Final = ("taskset", "-c", "0")
BUSY_LOOP = (sys.executable, "-c", "while True: pass")
GRACE_S = 20.0  # for a guest to be ended by the program that started it
SUMMARY = re.compile(r"^=* ?(?P<counts>\d+ (?:passed|failed|error).*) in [\d.]+s\b", re.MULTILINE)
COUNT = re.compile(r"(\d+) (\w+)")
FAILED = re.compile(r"^(?:FAILED|ERROR) .*", re.MULTILINE)
OUTCOMES = frozenset({"passed", "failed", "errors", "error", "xfailed", "xpassed", "skipped"})


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """A run that was asked for: the number of its order, and what it is run under."""

    seed: int
    condition: str

    @property
    def is_on_one_core(self) -> bool:
        """Whether it has the first core alone."""
        return self.condition in {ONE_CORE, ONE_CORE_BUSY}

    @property
    def is_beside_loops(self) -> bool:
        """Whether loops that never rest run beside it."""
        return self.condition in {BUSY, ONE_CORE_BUSY}


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """What came of it."""

    asked: Asked
    collected: int
    passed: int
    failed: int
    minutes: float
    status: int
    failures: tuple[str, ...]


def asked_for(text: str) -> Asked:
    """Return the run that an argument asks for."""
    seed, _, condition = text.partition(":")
    if not seed.isdigit() or (condition or IDLE) not in CONDITIONS:
        raise argparse.ArgumentTypeError(f"a run is a number, or a number with one of {', '.join(CONDITIONS)}: 13:busy")
    return Asked(seed=int(seed), condition=condition or IDLE)


def run_of(asked: Asked, said: str, *, status: int, minutes: float) -> Run:
    """Return what a run came to, from what it said: host and guest each end with one line of counts."""
    counts: dict[str, int] = {}
    for summary in SUMMARY.finditer(said):
        for number, outcome in COUNT.findall(summary["counts"]):
            counts[outcome] = counts.get(outcome, 0) + int(number)
    return Run(
        asked=asked,
        collected=sum(number for outcome, number in counts.items() if outcome in OUTCOMES),
        passed=counts.get("passed", 0),
        failed=sum(counts.get(outcome, 0) for outcome in ("failed", "error", "errors")),
        minutes=minutes,
        status=status,
        failures=tuple(FAILED.findall(said)),
    )


def table(runs: Sequence[Run]) -> str:
    """Return the runs as a table of Markdown, and below it what failed in them."""
    lines = [
        "| order | conditions | collected | passed | failed | minutes | status |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {run.asked.seed} | {run.asked.condition} | {run.collected} | {run.passed} | {run.failed} "
            f"| {run.minutes:.1f} | {run.status} |"
            for run in runs
        ),
        "| all | | {} | {} | {} | {:.1f} | |".format(
            *(sum(getattr(run, name) for run in runs) for name in ("collected", "passed", "failed", "minutes"))
        ),
        "",
        *(f"- order {run.asked.seed}, {run.asked.condition}: {name}" for run in runs for name in run.failures),
    ]
    return "\n".join(lines).rstrip() + "\n"


@contextlib.contextmanager
def started(command: Sequence[str], said: IO[bytes]) -> Iterator[psutil.Popen]:
    """Start a process, and end it with all that it started, wherever those went."""
    process = psutil.Popen(command, cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        ended: list[psutil.Process] = []
        with contextlib.suppress(psutil.NoSuchProcess):
            ended = [*process.children(recursive=True), process]
        for order in (psutil.Process.terminate, psutil.Process.kill):
            for one in ended:
                with contextlib.suppress(psutil.NoSuchProcess):
                    order(one)
            _, ended = psutil.wait_procs(ended, GRACE_S)


def done(asked: Asked, *, target: str, loops: int, said: Path) -> Run:
    """Run the suite once, and return what came of it."""
    where = FIRST_CORE if asked.is_on_one_core else ()
    with contextlib.ExitStack() as started_here:
        stream = started_here.enter_context(said.open("wb"))
        for _ in range(loops if asked.is_beside_loops else 0):
            started_here.enter_context(started((*where, *BUSY_LOOP), stream))
        begin_s = time.monotonic()
        suite = started_here.enter_context(
            started((*where, "make", "--no-print-directory", target, f"ORDER={asked.seed}"), stream)
        )
        status = suite.wait()
        minutes = (time.monotonic() - begin_s) / 60.0
    return run_of(asked, said.read_text(encoding="utf-8", errors="replace"), status=status, minutes=minutes)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=asked_for, metavar="ORDER[:CONDITION]")
    parser.add_argument("--folder", type=Path, required=True, help="for what the runs say, and for table.md")
    parser.add_argument("--loops", type=int, default=4, help="how many loops that never rest run beside a busy run")
    parser.add_argument("--target", default="test-both", help="of make")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    runs: list[Run] = []
    for asked in options.runs:
        said = options.folder / f"{asked.seed}-{asked.condition}.txt"
        print(f"order {asked.seed}, {asked.condition}: see {said}", flush=True)
        runs.append(done(asked, target=options.target, loops=options.loops, said=said))
        (options.folder / "table.md").write_text(table(runs), encoding="utf-8")
        print(table(runs), flush=True)
    return int(any(run.failed or run.status for run in runs))


if __name__ == "__main__":
    sys.exit(main())
