"""Damaged tables of signals in every dialect, read for some time: only ``CanlogError`` may come, and nothing may hang.

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

from tests.support.table_dialects import drawn, drive_of, written
from tests.tools.damaged_logs import HangError, damaged, outcome

ROWS = range(60)


def outcomes(seed: int, folder: Path, end_s: float, most: int) -> Counter[tuple[str, str]]:
    """Read damaged tables until a time or a number of them, and return what came of which clock how often."""
    rng, counts, path = random.Random(seed), Counter[tuple[str, str]](), folder / "table.csv"  # noqa: S311 - repeats
    while time.monotonic() < end_s and counts.total() < most:
        dialect, step_ms = drawn(rng), rng.randrange(1, 2000)
        text = written(drive_of([900.0 + 20 * row for row in ROWS], [row / 100.0 for row in ROWS], step_ms), dialect)
        path.write_bytes(damaged(text, rng))
        counts[dialect.clock, outcome(path)] += 1
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()

    def hangs(_: int, __: FrameType | None) -> None:
        raise HangError

    signal.signal(signal.SIGALRM, hangs)
    with tempfile.TemporaryDirectory() as folder:
        counts = outcomes(arguments.seed, Path(folder), time.monotonic() + arguments.seconds, 10**9)
    for (name, what), count in sorted(counts.items()):
        print(f"{name}: {count} {what}")
    print(f"seed {arguments.seed}, {counts.total()} tables")


if __name__ == "__main__":
    main()
