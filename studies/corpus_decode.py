"""Every database in some folders: what ``decode`` writes for random logs, cell by cell against cantools.

    python -m studies.corpus_decode FOLDER|FILE... [--payloads 100] [--seed 1]

For each file logs are written with frames of all its messages, of every length, classic and CAN FD; ``decode`` makes a
wide and a long Parquet file of them; and numbers and texts in these are held against cantools. Prints how many values
were compared, how many differ in any bit, how many are null though cantools gives a number, and why. Status 1 if
anything differs or is null without a reason. Nothing of the files is kept.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from studies.decoding.comparison import Tally, compare_database, explained
from canlog.errors import DefinitionError

SUFFIXES = frozenset({".dbc", ".kcd", ".arxml", ".sym"})
SHOWN_COUNT = 5


def databases(places: Sequence[Path]) -> Iterator[Path]:
    """Yield the databases among some files and in some folders and those below."""
    for place in places:
        if place.is_file():
            yield place
            continue
        yield from sorted(path for path in place.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())


def report(path: Path, count: int, seed: int) -> Tally | None:
    """Compare one file and print what was found; None if it cannot be loaded."""
    try:
        tally = compare_database(path, count, seed)
    except DefinitionError as error:
        print(f"{path.name}: refused: {error}")
        return None
    print(f"{path.name}: {words(tally)}")
    for head, lines in (("refused", tally.refusals), ("WRONG", tally.examples)):
        for line in lines[:SHOWN_COUNT]:
            print(f"  {head}: {line}")
        if len(lines) > SHOWN_COUNT:
            print(f"  and {len(lines) - SHOWN_COUNT} more")
    sys.stdout.flush()
    return tally


def words(tally: Tally) -> str:
    """Return the numbers of a tally for people."""
    return (
        f"{tally.messages} messages, {tally.signals} signals, {tally.values} values and {tally.texts} texts compared, "
        f"{tally.different + tally.different_texts} different, {tally.extra} that cantools does not give, "
        f"{tally.miscounted} miscounted; null though cantools gives a number: {explained(tally.null)}; "
        f"{len(tally.refusals)} refusals"
    )


def main() -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("places", nargs="+", type=Path, metavar="FOLDER|FILE")
    parser.add_argument("--payloads", type=int, default=100, help="payloads for each message (100)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    found = [report(path, max(4, arguments.payloads), arguments.seed) for path in databases(arguments.places)]
    total = Tally()
    for tally in found:
        if tally is not None:
            total.add(tally)
    refused = sum(tally is None for tally in found)
    print(f"{len(found)} databases, {refused} of them refused: {words(total)}")
    return 1 if total.wrong or not total.values else 0


if __name__ == "__main__":
    sys.exit(main())
