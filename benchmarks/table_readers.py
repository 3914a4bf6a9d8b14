"""What a user would miss without our readers of text tables and SQLite: speed, and frames of logs that are not perfect.

The same frames in each format, read by us and by python-can where it has a reader; processor time of one core, medians
of rounds in turn. Then logs that users have, a hundred frames each: with a line that is none in their middle, cut off,
and with frames of CAN FD.

    python -m benchmarks.table_readers [--frames 200000] [--rounds 3]
"""

import argparse
import sqlite3
import statistics
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import can
from rich.console import Console
from rich.table import Table

from benchmarks.bus64 import frames, write_log
from benchmarks.measuring import machine, took_s
from canlog.errors import SourceError
from canlog.frames import FD_FLAG
from canlog.logs import read_log

FEW: Final = 100
CAN_READS: Final = (".trc", ".csv", ".db")
BUSMASTER_HEAD: Final = """***BUSMASTER Ver 3.2.2***
***PROTOCOL CAN***
***START DATE AND TIME 1:1:2026 0:0:0:000***
***HEX***
***ABSOLUTE MODE***
"""


def gvret_line(t_s: float, can_id: int, data: bytes) -> str:
    return f"{t_s * 1e6:.0f},{can_id:08X},false,Rx,0,{len(data)},{''.join(f'{byte:02X},' for byte in data)}\n"


def busmaster_line(t_s: float, can_id: int, data: bytes) -> str:
    whole_s, part = divmod(round(t_s * 1e4), 10_000)
    clock = f"{whole_s // 3600}:{whole_s // 60 % 60}:{whole_s % 60}:{part:04d}"
    return f"{clock} Rx 1 0x{can_id:03X} s {len(data)} {data.hex(' ').upper()}\n"


def crtd_line(t_s: float, can_id: int, data: bytes) -> str:
    return f"{t_s:.6f} 1R11 {can_id:03X} {data.hex(' ')}\n"


HAND_MADE: Final[dict[str, tuple[str, Callable[[float, int, bytes], str]]]] = {
    "gvret": ("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n", gvret_line),
    "busmaster": (BUSMASTER_HEAD, busmaster_line),
    "crtd": ("", crtd_line),
}


def write_database(path: Path, rows: Sequence[tuple[float, int, int | None, bytes]]) -> None:
    """Write time, identifier, length and payload as python-can does (its writer loses what waits in its queue)."""
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(
            "CREATE TABLE messages(ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, "
            "error INTEGER, dlc INTEGER, data BLOB)"
        )
        database.executemany("INSERT INTO messages VALUES (?, ?, 0, 0, 0, ?, ?)", rows)


def written(folder: Path, count: int) -> list[Path]:
    """Write the same frames in every format."""
    paths = [write_log(folder / f"drive{suffix}", count) for suffix in (".trc", ".csv")]
    recorded = frames(count)
    rows = list(zip(recorded.t_s.tolist(), recorded.can_id.tolist(), map(bytes, recorded.data), strict=True))
    database = folder / "drive.db"
    write_database(database, [(t_s, can_id, len(data), data) for t_s, can_id, data in rows])
    paths.append(database)
    for name, (head, line) in HAND_MADE.items():
        path = folder / f"drive.{name}"
        path.write_text(head + "".join(line(1e3 + t_s, can_id, data) for t_s, can_id, data in rows), encoding="ascii")
        paths.append(path)
    return paths


def ours(path: Path) -> int:
    """Return how many frames we read."""
    try:
        return sum(len(batch) for batch in read_log(path))
    except SourceError:
        return 0


def python_can(path: Path) -> int:
    """Return how many frames python-can reads before it ends or raises."""
    count = 0
    try:
        with can.LogReader(path) as reader:
            for _ in reader:
                count += 1
    except Exception:  # noqa: BLE001 - what a user gets is what came before
        return count
    return count


def speeds(paths: Sequence[Path], count: int, rounds: int) -> Table:
    """Measure every reader, in turn."""
    table = Table("format", "ours, M frames/s", "python-can, M frames/s", "ratio")
    for path in paths:
        found = ours(path)  # compiles, too
        if found != count:
            raise RuntimeError(f"{path.name}: {found} of {count} frames")
        times_s: list[list[float]] = [[], []]
        for _ in range(rounds):
            times_s[0].append(took_s(partial(ours, path)))
            if path.suffix in CAN_READS:
                times_s[1].append(took_s(partial(python_can, path)))
        mine, theirs = (count / statistics.median(taken) / 1e6 if taken else 0.0 for taken in times_s)
        cells = (f"{theirs:.3f}", f"{mine / theirs:.3g}") if theirs else ("no reader", "")
        table.add_row(path.suffix[1:], f"{mine:.3g}", *cells)
    return table


def damaged(folder: Path) -> list[tuple[str, Path]]:
    """Write small logs as users have them; return what is the matter with each."""
    found: list[tuple[str, Path]] = []
    for suffix in (".trc", ".csv"):
        lines = write_log(folder / f"whole{suffix}", FEW).read_bytes().splitlines(keepends=True)
        middle = len(lines) - FEW // 2
        for what, content in (
            ("a line of noise in the middle", [*lines[:middle], b"what is this\r\n", *lines[middle:]]),
            ("cut inside its last line", [*lines[:-1], lines[-1][: len(lines[-1]) // 2]]),
        ):
            path = folder / f"{what.replace(' ', '-')}{suffix}"
            path.write_bytes(b"".join(content))
            found.append((what, path))
    path = folder / "rows.db"
    write_database(path, [(number, number, None if number == FEW // 2 else 8, bytes(8)) for number in range(FEW)])
    return [*found, ("a row without a length", path)]


def kept_fd(path: Path) -> tuple[int, int]:
    """Return in how many frames of CAN FD we and python-can see that they are."""
    mine = sum(int((batch.flags & FD_FLAG != 0).sum()) for batch in read_log(path))
    with can.LogReader(path) as reader:
        return mine, sum(message.is_fd for message in reader)


def losses(folder: Path) -> Table:
    """Count what is read of logs that are not perfect."""
    table = Table("log", "frames", "ours", "python-can")
    for what, path in damaged(folder):
        table.add_row(f"{path.suffix[1:]}: {what}", str(FEW), str(ours(path)), str(python_can(path)))
    csv, database = folder / "fd.csv", folder / "fd.db"
    with can.CSVWriter(csv) as writer:
        for number in range(FEW):
            writer.on_message_received(can.Message(timestamp=number, arbitration_id=number, is_fd=True, data=bytes(12)))
    write_database(database, [(number, number, 12, bytes(12)) for number in range(FEW)])
    for path in (csv, database):
        mine, theirs = kept_fd(path)
        table.add_row(f"{path.suffix[1:]}: CAN FD of 12 bytes, seen as such", str(FEW), str(mine), str(theirs))
    return table


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200_000, help="of each log (%(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="of which the medians are printed (%(default)s)")
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # of python-can
    can.set_logging_level("critical")
    console = Console(width=110)
    with TemporaryDirectory() as name:
        folder = Path(name)
        paths = written(folder, options.frames)
        console.print(f"{options.frames} frames, medians of {options.rounds} rounds; {machine()}")
        console.print(speeds(paths, options.frames, options.rounds))
        console.print(losses(folder))


if __name__ == "__main__":
    main()
