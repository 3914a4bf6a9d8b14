"""Damage recordings in every way, and hold what the service makes of them against what was done.

A sound recording of three shifts is damaged in one way after the other: bits flipped, ends cut off, garbage put in,
lines and objects garbled, swapped, repeated and lost, times made to jump. Whatever is done, reading ends, nothing
breaks, counts match what was done where that can be known, no accepted estimate is further than four of its standard
deviations from the truth or from that of the sound recording, and none reaches over a jump of time. Tables of signals
are damaged in the grammars of ten writers.

    python -m tests.tools.damage --format blf --count 200
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.tools.damage.recordings import SUFFIXES
from tests.tools.damage.tables import GRAMMARS
from tests.tools.damage.trial import run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--format", choices=(*SUFFIXES, *GRAMMARS), action="append", help="default: all")
    parser.add_argument("--count", type=int, default=200, help="of damages to each format (200)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    wrong_count = 0
    with TemporaryDirectory() as folder:
        for log_format in options.format or (*SUFFIXES, *GRAMMARS):
            tally = run(log_format, options.count, options.seed, Path(folder))
            wrong_count += len(tally.wrong)
            print(tally.said, flush=True)
            for problem in tally.wrong:
                print(f"  {problem}", flush=True)
    print(f"{wrong_count} things that must not be")
    return 1 if wrong_count else 0


if __name__ == "__main__":
    sys.exit(main())
