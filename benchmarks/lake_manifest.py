"""What the manifest of a large lake costs: a year of 10,000 vehicles, a log a day each, made up; memory and time.

The rows are made without logs. Then a process each opens the manifest whole, as no command does, opens what a run for
one vehicle and for one group needs, looks for logs that changed their vehicle, goes through all partitions, adds a
night's logs, and forgets a vehicle.

    python -m benchmarks.lake_manifest --vehicles 10000 --days 365
"""

import argparse
import multiprocessing
import resource
import time
from collections.abc import Callable, Iterator
from tempfile import TemporaryDirectory

from benchmarks.measuring import machine
from diag_service.lake.parts import DONE, FOLDER, FULL_ROWS, LogRow, Manifest, forget, partition_of, partitions, strayed
from diag_service.lake.places import Place

ACCOUNT_BYTES = 1000  # those of logs with many shifts are longer; no step but sharing rows out reads them
SOME_DAYS = 7  # added at once, while the manifest is made
MOVED = "/logs/car000007/000.log"


def rows_of(day: int, vehicle_count: int) -> Iterator[LogRow]:
    """Yield the rows of one day's logs."""
    for number in range(vehicle_count):
        vehicle, content = f"car{number:06}", f"{day * vehicle_count + number:064x}"
        yield LogRow(
            source=f"/logs/{vehicle}/{day:03}.log",
            key=content[::-1],
            size_bytes=10_000_000,
            vehicle=vehicle,
            content=content,
            settings="5" * 64,
            signals="",
            algorithm_version="torque-impulse-14",
            outcome=DONE,
            reason="",
            shifts=300,
            attempts=1,
            parts=(f"shifts/date=2026-01-{day:03}/vehicle={vehicle}/{content[-32:]}-{'5' * 16}.parquet",),
            account="x" * ACCOUNT_BYTES,
            made_at="2026-01-01T00:00:00.000000Z",
        )


def make(place: Place, days: int, vehicle_count: int) -> int:
    """Make a manifest; return how many rows it has."""
    for first in range(0, days, SOME_DAYS):
        manifest = Manifest(place, ())
        some = range(first, min(first + SOME_DAYS, days))
        manifest.add([row for day in some for row in rows_of(day, vehicle_count)])
        manifest.put_together()
    return days * vehicle_count


def add_night(place: Place, day: int, vehicle_count: int) -> int:
    """Add a day's logs and put the manifest together, as a run does; return how many."""
    rows = list(rows_of(day, vehicle_count))
    manifest = Manifest(place, ())
    manifest.add(rows)
    manifest.put_together()
    return len(rows)


def measured(title: str, work: Callable[[], int]) -> None:
    """Print what a process of its own takes for some work: ours stays small, or its memory would be theirs."""
    process = multiprocessing.get_context("fork").Process(target=_tell, args=(title, work))
    process.start()
    process.join()
    if process.exitcode:
        raise SystemExit(process.exitcode)


def _tell(title: str, work: Callable[[], int]) -> None:
    before_kib, began_s = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    count = work()
    took_s = time.monotonic() - began_s
    more_mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib) / 1024.0
    print(f"{title}: {count:,} rows, {took_s:.1f} s, {more_mib:,.0f} MiB more", flush=True)


def main() -> None:
    """Make a manifest, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=10_000)
    parser.add_argument("--days", type=int, default=365)
    parser.add_argument("--keep", metavar="FOLDER", help="keep the manifest there, or take up what was kept")
    parser.add_argument("--whole", action="store_true", help="also open all of it at once, some 2 kB a row")
    options = parser.parse_args()
    print(machine())
    with TemporaryDirectory() as folder:
        place = Place(options.keep or folder)
        count = options.days * options.vehicles
        if not place.held(FOLDER):
            measured("made", lambda: make(place, options.days, options.vehicles))
        files = place.held(FOLDER).values()
        print(f"{count:,} rows in {len(files):,} files, {sum(one.size_bytes for one in files) / 1e9:.2f} GB")
        vehicle = "car000007"
        if options.whole:
            measured("all at once", lambda: len(Manifest(place).rows))
        measured("for one vehicle, or a group of a run", lambda: len(Manifest(place, [partition_of(vehicle)]).rows))
        measured("check, a partition at a time", lambda: sum(map(len, partitions(place))))
        measured("logs of another vehicle", lambda: len(strayed(place, {MOVED: "other"})))
        measured(f"a night of {options.vehicles:,} logs", lambda: add_night(place, options.days, options.vehicles))
        measured(
            f"a night as rows are shared out ({FULL_ROWS:,})", lambda: add_night(place, options.days + 1, FULL_ROWS)
        )
        measured("forget a vehicle", lambda: forget(place, vehicle).rows)


if __name__ == "__main__":
    main()
