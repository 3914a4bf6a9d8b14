"""What an hour on the road takes in a lake and of a processor: shifts alone, and with all decoded signals.

One WLTC of half an hour is driven, a few minutes of work; copies of it on later days go through
``diag-service analyze --lake``. What one of them takes is the difference of two runs, so that the start of the program
does not count.

    python -m studies.lake_day
"""

import subprocess
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import pyarrow.parquet as pq

from studies.decoding.hour import NS_PER_S, record_drive, write_drive
from studies.measuring import machine, took_s
from canlog.frames import FrameBatch
from tests.support.service import PROGRAM, environment

FEW, MANY = 1, 4  # logs
HOUR_S: Final = 3600.0
DAY_NS: Final = 24 * 3600 * NS_PER_S
SUFFIXES: Final = (".log", ".blf", ".mf4")
OF_LAKE: Final = ".blf"


def written(drive: FrameBatch, folder: Path, count: int) -> Path:
    """Write a drive on so many days, a log each, into a folder."""
    folder.mkdir()
    for day in range(count):
        write_drive(drive, folder / f"drive{day}{OF_LAKE}", later_ns=day * DAY_NS)
    return folder


def into_lake(logs: Path, lake: Path, *options: str) -> None:
    """Analyse the logs of a folder."""
    command = [*PROGRAM, "analyze", str(logs), "--lake", str(lake), "--jobs", "1", *options]
    subprocess.run(command, check=True, capture_output=True, env=environment())


def stored(lake: Path, room: str) -> tuple[int, int]:
    """Return the size of one kind of parts [bytes], and how many rows they have."""
    parts = list((lake / room).rglob("*.parquet"))
    return sum(part.stat().st_size for part in parts), sum(pq.read_metadata(part).num_rows for part in parts)


def main() -> None:
    """Measure and print, per hour of driving."""
    print(machine())
    with TemporaryDirectory() as name:
        folder = Path(name)
        drive = record_drive(folder, "--drive", "wltc")
        duration_s = float(drive.t_ns[-1] - drive.t_ns[0]) / NS_PER_S
        print(f"{len(drive) / duration_s * HOUR_S:,.0f} frames an hour")
        for suffix in SUFFIXES:
            log = folder / f"size{suffix}"
            write_drive(drive, log)
            print(f"log {suffix:5} {log.stat().st_size / 1e6 * HOUR_S / duration_s:8.1f} MB an hour", flush=True)
        few, many = written(drive, folder / "few", FEW), written(drive, folder / "many", MANY)
        hours = (MANY - FEW) * duration_s / HOUR_S
        for title, options in (("shifts", ()), ("shifts and signals", ("--signals", "*"))):
            short, whole = folder / f"{title} few", folder / f"{title} many"
            start_s = took_s(partial(into_lake, few, short, *options))
            took = took_s(partial(into_lake, many, whole, *options)) - start_s
            for room in ("shifts", "signals"):
                (size, rows), (less, fewer) = stored(whole, room), stored(short, room)
                if size:
                    print(f"{title}: {room} {(size - less) / hours / 1e6:.2f} MB, {(rows - fewer) / hours:,.0f} rows")
            print(f"{title}: {took / hours:.1f} s of a core, each an hour of driving", flush=True)


if __name__ == "__main__":
    main()
