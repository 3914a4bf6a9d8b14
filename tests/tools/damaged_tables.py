"""Damaged tables of signals in every dialect and layout, read for some time: only ``CanlogError`` may come.

A table that takes two minutes counts as hanging. ``--only`` names a clock or the layout of a program.

python -m tests.tools.damaged_tables --seconds 600 --seed 1
"""

import argparse
import random
import signal
import tempfile
import time
from collections import Counter
from pathlib import Path
from types import FrameType

from tests.support.table_dialects import CLOCKS, PROGRAMS, drawn, drive_of, written
from tests.tools.damaged_logs import HangError, damaged, outcome

ROWS = range(60)


def outcomes(seed: int, folder: Path, end_s: float, most: int, only: str = "") -> Counter[tuple[str, str]]:
    """Read damaged tables until a time or a number of them, and return what came of which clock or layout how often."""
    rng, counts, path = random.Random(seed), Counter[tuple[str, str]](), folder / "table.csv"  # noqa: S311 - repeats
    while time.monotonic() < end_s and counts.total() < most:
        dialect, program, step_ms = drawn(rng), rng.choice([*[""] * len(PROGRAMS), *PROGRAMS]), rng.randrange(1, 2000)
        if only in PROGRAMS:
            program = only
        elif only and (program or dialect.clock != only):
            continue
        drive = drive_of([900.0 + 20 * row for row in ROWS], [row / 100.0 for row in ROWS], step_ms)
        text = PROGRAMS[program](drive) if program else written(drive, dialect)
        path.write_bytes(damaged(text, rng))
        counts[program or dialect.clock, outcome(path)] += 1
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=[*CLOCKS, *PROGRAMS], default="")
    arguments = parser.parse_args()

    def hangs(_: int, __: FrameType | None) -> None:
        raise HangError

    signal.signal(signal.SIGALRM, hangs)
    with tempfile.TemporaryDirectory() as folder:
        counts = outcomes(arguments.seed, Path(folder), time.monotonic() + arguments.seconds, 10**9, arguments.only)
    for (name, what), count in sorted(counts.items()):
        print(f"{name}: {count} {what}")
    print(f"seed {arguments.seed}, {counts.total()} tables")


if __name__ == "__main__":
    main()
