"""Every output of ``decode`` for random databases and logs, read by two libraries and equal to cantools.

    python -m tests.tools.decode_outputs [--cases 2000] [--first 1]

Layouts wide, long and messages, as Parquet, CSV, JSON lines and Arrow, and MF4. A case is made of its number alone.
MF4 is read by mdfreader as well, where that is installed (`pip install mdfreader`; GPL, so no part of the lock).
"""

import argparse
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.decode_outputs import compare, random_case

SHOWN_COUNT = 3  # of what is wrong in a case


def main() -> int:
    """Compare, print, and return 1 if anything differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=2_000)
    parser.add_argument("--first", type=int, default=1, help="number of the first case")
    options = parser.parse_args()
    files, rows, wrong = Counter[str](), 0, 0
    for number in range(options.first, options.first + options.cases):
        with TemporaryDirectory() as folder:
            findings = compare(random_case(number), Path(folder))
        files.update(findings.files)
        rows += findings.cells
        wrong += bool(findings.wrong)
        for line in findings.wrong[:SHOWN_COUNT]:
            print(f"case {number}: {line}", flush=True)
    for label, count in sorted(files.items()):
        print(f"{label}: {count} files")
    print(
        f"{options.cases} cases, {files.total():,} files read, {rows:,} rows compared, {wrong} cases with differences"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
