"""Speed of the log readers, each beside a named peer in the same run.

2,000,000 frames of ten messages with 64 signals; every contender in turn, several rounds, medians. Peers that take
microseconds a frame are measured on the first frames of the log and scaled by their number. Times are of the processor,
this process and its children, so that others on the machine count little; the child that reads MF4 does its work here.

    python -m benchmarks.readers
"""

import argparse
import os
import platform
import resource
import statistics
import subprocess
import sys
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can
from rich.console import Console
from rich.table import Table

from benchmarks.bus64 import Decoder, dbc_text, load_bus, write_log
from diag_service.frames import FrameBatch
from diag_service.sources import read_log
from diag_service.sources.blf import CONTAINER_HEADER
from diag_service.sources.blf_objects import OBJECT_HEADER
from diag_service.sources.mf4 import mf4_batches
from diag_service.sources.tally import Tally

FRAMES = 2_000_000
SAMPLE_FRAMES = 30_000
ROUNDS = 3
LEAST_S = 1e-4  # about the resolution of these times
MEBI = 1024 * 1024
FILE_HEADER_BYTES = 144  # of a BLF file
SUFFIXES = (".log", ".blf", ".asc", ".mf4")


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """Something that reads a log."""

    name: str
    work: Callable[[], object]
    frames: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A reader beside its peer."""

    ours: Contender
    peer: Contender
    needed: float | None = None


def decoded(path: Path) -> int:
    """Read a log and decode all its signals; return the number of values."""
    decoder = Decoder()
    return sum(len(values) for batch in batches(path) for values in decoder.decode(batch))


def batches(path: Path) -> Iterator[FrameBatch]:
    """Read a log in this process."""
    with TemporaryDirectory() as folder:
        yield from mf4_batches(path, Path(folder), Tally()) if path.suffix == ".mf4" else read_log(path)


def read_only(path: Path) -> int:
    """Read a log; return the number of frames."""
    return sum(len(batch) for batch in read_log(path))


def python_can(path: Path, *, is_decoded: bool) -> int:
    """Read the first frames of a log with python-can, and decode them with cantools."""
    database, count = load_bus(), 0
    with can.LogReader(path) as reader:
        for message in reader:
            if is_decoded:
                database.decode_message(message.arbitration_id, bytes(message.data), decode_choices=False)
            count += 1
            if count == SAMPLE_FRAMES:
                break
    return count


def asammdf_physical(path: Path, dbc: Path) -> int:
    """Extract the signals of an MF4 log with asammdf and take their physical values."""
    from asammdf import MDF  # noqa: PLC0415 - heavy, and a peer only here

    count = 0
    extracted: Any
    with MDF(path) as log, log.extract_bus_logging(database_files={"CAN": [(dbc, 0)]}) as extracted:
        for index, group in enumerate(extracted.groups):
            for channel in range(1, len(group.channels)):
                count += len(extracted.get(group=index, index=channel).physical())
    return count


def inflate_only(path: Path) -> int:
    """Inflate the containers of a BLF log and nothing else."""
    contents, at, total = path.read_bytes(), FILE_HEADER_BYTES, 0
    while at + OBJECT_HEADER.size < len(contents):
        _, _, _, size, _ = OBJECT_HEADER.unpack_from(contents, at)
        total += len(zlib.decompress(contents[at + OBJECT_HEADER.size + CONTAINER_HEADER.size : at + size]))
        at += size + size % 4
    return total


def count_lines(path: Path) -> None:
    """Count the lines of a text with ``wc``."""
    subprocess.run(["wc", "-l", str(path)], check=True, capture_output=True)


def rows(folder: Path, count: int) -> list[Row]:
    """Return what is measured, on logs that are written into the folder."""
    logs = {suffix: write_log(folder / f"drive{suffix}", count) for suffix in SUFFIXES}
    dbc = folder / "bus.dbc"
    dbc.write_text(dbc_text(), encoding="ascii")
    sample = min(SAMPLE_FRAMES, count)

    def ours(suffix: str, *, is_decoded: bool = True) -> Contender:
        what, work = ("columns", decoded) if is_decoded else ("frames", read_only)
        return Contender(name=f"{suffix} to {what}", work=lambda: work(logs[suffix]), frames=count)

    def peer(suffix: str, *, is_decoded: bool = True) -> Contender:
        name = "python-can + cantools" if is_decoded else "python-can"
        return Contender(name=name, work=lambda: python_can(logs[suffix], is_decoded=is_decoded), frames=sample)

    physical = Contender(
        name="asammdf extract + physical", work=lambda: asammdf_physical(logs[".mf4"], dbc), frames=count
    )
    lines = Contender(name="wc -l", work=lambda: count_lines(logs[".log"]), frames=count)
    bare = Contender(name="bare inflate (zlib)", work=lambda: inflate_only(logs[".blf"]), frames=count)
    return [
        Row(ours=ours(".log"), peer=peer(".log"), needed=80.0),
        Row(ours=ours(".blf"), peer=peer(".blf"), needed=60.0),
        Row(ours=ours(".asc", is_decoded=False), peer=peer(".asc", is_decoded=False), needed=30.0),
        Row(ours=ours(".mf4"), peer=physical, needed=2.5),
        Row(ours=ours(".log", is_decoded=False), peer=lines),
        Row(ours=ours(".blf", is_decoded=False), peer=bare),
    ]


def processor_s() -> float:
    """Return the time that this process and its ended children have had [s]."""
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in spent)


def seconds(work: Callable[[], object]) -> float:
    """Return how long some work keeps a processor busy [s]."""
    began_s = processor_s()
    work()
    return max(processor_s() - began_s, LEAST_S)


def growth_bytes(path: Path) -> int:
    """Return by how much a process grows while it streams a log, after the first tenth of it."""
    report = subprocess.run(
        [sys.executable, "-m", "benchmarks.readers", "--grow", str(path)], check=True, capture_output=True, text=True
    )
    return int(report.stdout)


def print_growth(path: Path) -> None:
    """Stream a log to columns and print the growth of this process [bytes]."""
    decoder, early_kib = Decoder(), 0
    for number, batch in enumerate(read_log(path)):
        for _ in decoder.decode(batch):
            pass
        if number == 2:
            early_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    sys.stdout.write(str((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - early_kib) * 1024))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--grow", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.grow:
        print_growth(options.grow)
        return
    warnings.simplefilter("ignore")  # of the peers
    console = Console(width=110)
    with TemporaryDirectory() as name:
        measured = rows(Path(name), options.frames)
        for row in measured:
            row.ours.work()  # compiles and fills caches
        table = Table("reader", "M frames/s", "peer", "M frames/s", "ratio", "needed")
        times_s: list[list[tuple[float, float]]] = [[] for _ in measured]
        for _ in range(options.rounds):
            for row, taken in zip(measured, times_s, strict=True):
                taken.append((seconds(row.ours.work), seconds(row.peer.work)))
        for row, taken in zip(measured, times_s, strict=True):
            ours = row.ours.frames / statistics.median(first for first, _ in taken)
            peer = row.peer.frames / statistics.median(second for _, second in taken)
            ratio = statistics.median(
                second / row.peer.frames * row.ours.frames / first for first, second in taken
            )  # fmt: skip
            needed = "" if row.needed is None else f">= {row.needed:g}"
            table.add_row(
                row.ours.name, f"{ours / 1e6:.2f}", row.peer.name, f"{peer / 1e6:.3f}", f"{ratio:.3g}", needed
            )
        console.print(table)
        for suffix in SUFFIXES:
            grown = growth_bytes(Path(name) / f"drive{suffix}") / MEBI
            console.print(
                f"streaming {suffix} to columns: this process grows by {grown:.1f} MiB past the first batches"
            )
    console.print(
        f"{options.frames} frames, medians of {options.rounds} rounds; python-can on the first {SAMPLE_FRAMES} frames, "
        f"per frame; {platform.processor() or platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}"
    )


if __name__ == "__main__":
    main()
