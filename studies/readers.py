"""Speed of the log readers, each beside a named peer in the same run.

2,000,000 frames of a hundred messages with 700 signals, for us and for every peer; all contenders in turn, several
rounds, medians. Times are of the processor, one core: this process and its children, so that others on the machine
count little.

    python -m studies.readers [--frames 2000000] [--rounds 3]
"""

import statistics
import subprocess
import sys
import warnings
import zlib
from argparse import SUPPRESS
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import can
from rich.console import Console
from rich.table import Table

from canlog.decode.codec import Codec
from canlog.frames import FrameBatch
from canlog.logs import read_log
from canlog.logs.blf import CONTAINER_HEADER, OBJECT_HEADER
from studies import bars
from studies.run import machine, parsed, peak_mib, study_parser, took_s
from studies.wide_bus import database, frames, write_database, write_log

FRAMES: Final = 2_000_000
ROUNDS: Final = 3
FILE_HEADER_BYTES: Final = 144  # of a BLF file
SUFFIXES: Final = (".log", ".blf", ".mf4")


@dataclass(frozen=True, slots=True)
class Contender:
    """Something that reads a log."""

    name: str
    work: Callable[[], object]


@dataclass(frozen=True, slots=True)
class ReaderRow:
    """A reader beside its peer."""

    ours: Contender
    peer: Contender
    bar: bars.Bar | None = None


def batches(path: Path) -> Iterator[FrameBatch]:
    """Read a log in this process."""
    yield from read_log(path)


def decoded(path: Path, codec: Codec) -> int:
    """Read a log and decode all its signals; return the number of values."""
    messages = (message for batch in batches(path) for message in codec.decode(batch))
    return sum(len(signal.value) for message in messages for signal in message.signals.values())


def read_only(path: Path) -> int:
    """Read a log; return the number of frames."""
    return sum(len(batch) for batch in batches(path))


def python_can_and_cantools(path: Path, decode: Callable[..., object]) -> int:
    """Read a log with python-can, and decode it with cantools."""
    count = 0
    with can.LogReader(path) as reader:
        for message in reader:
            decode(message.arbitration_id, bytes(message.data), decode_choices=False)
            count += 1
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


def new_codec() -> Codec:
    """Return all signals of the bus, by the service's compiled tables."""
    return Codec(database().messages, check_range=False)


def rows(folder: Path, count: int) -> list[ReaderRow]:
    """Return what is measured, on logs that are written into the folder; databases are loaded before."""
    recorded = frames(count)
    logs = {suffix: write_log(folder / f"drive{suffix}", recorded) for suffix in SUFFIXES}
    text, blf_log, mf4 = (logs[suffix] for suffix in SUFFIXES)
    asc = folder / "drive.asc"
    with can.LogReader(text) as reader, can.ASCWriter(asc) as writer:
        for message in reader:
            writer.on_message_received(message)
    dbc = write_database(folder / "bus.dbc")
    decoder, decode = new_codec(), database().decode_message
    of_text = Contender("python-can + cantools", lambda: python_can_and_cantools(text, decode))
    of_blf = Contender("python-can + cantools", lambda: python_can_and_cantools(blf_log, decode))
    bare = Contender("bare inflate (zlib)", lambda: inflate_only(blf_log))
    of_asc = Contender("python-can + cantools", lambda: python_can_and_cantools(asc, decode))
    return [
        ReaderRow(Contender("candump to columns", lambda: decoded(text, decoder)), of_text, bars.LOGS),
        ReaderRow(Contender("BLF to columns", lambda: decoded(blf_log, decoder)), of_blf, bars.LOGS),
        ReaderRow(Contender("ASC to columns", lambda: decoded(asc, decoder)), of_asc, bars.LOGS),
        ReaderRow(
            Contender("MF4 to columns", lambda: decoded(mf4, decoder)),
            Contender("asammdf extract + physical", lambda: asammdf_physical(mf4, dbc)),
            bars.MF4,
        ),
        ReaderRow(
            Contender("candump to frames", lambda: read_only(text)),
            Contender("wc -l", lambda: count_lines(text)),
        ),
        ReaderRow(Contender("BLF to frames", lambda: read_only(blf_log)), bare),
    ]


def measured_s(contenders: Sequence[Contender], rounds: int) -> dict[Contender, list[float]]:
    """Return the times of all contenders, which take turns."""
    times_s: dict[Contender, list[float]] = {contender: [] for contender in contenders}
    for _ in range(rounds):
        for contender, taken in times_s.items():
            taken.append(took_s(contender.work))
    return times_s


def table_of(measured: Sequence[ReaderRow], count: int, rounds: int) -> Table:
    """Measure, and return what is printed."""
    contenders = list(dict.fromkeys(each for row in measured for each in (row.ours, row.peer)))
    times_s = measured_s(contenders, rounds)
    table = Table("reader", "M frames/s", "peer", "M frames/s", "ratio", "")
    for row in measured:
        ours_s, peer_s = times_s[row.ours], times_s[row.peer]
        ratio = statistics.median(theirs / ours for ours, theirs in zip(ours_s, peer_s, strict=True))
        speeds = [count / statistics.median(taken) / 1e6 for taken in (ours_s, peer_s)]
        verdict = "" if row.bar is None else row.bar.judged(ratio)
        cells = (row.ours.name, f"{speeds[0]:.2f}", row.peer.name, f"{speeds[1]:.3f}", f"{ratio:.3g}", verdict)
        table.add_row(*cells)
    return table


def growth_mib(path: Path) -> float:
    """Return by how much a new process grows while it streams a log to columns, after the first batches."""
    command = [sys.executable, "-m", "studies.readers", "--grow", str(path)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def print_growth(path: Path) -> None:
    """Stream a log to columns and print by how much this process grows past the first batches [MiB]."""
    codec, early_mib = new_codec(), 0.0
    for number, batch in enumerate(batches(path)):
        for message in codec.decode(batch):
            _ = [signal.value for signal in message.signals.values()]
        if number < 2:
            early_mib = peak_mib()
    sys.stdout.write(str(peak_mib() - early_mib))


def main() -> None:
    """Run the benchmark."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"frames of each log ({FRAMES})")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"of which the medians are printed ({ROUNDS})")
    parser.add_argument("--grow", type=Path, help=SUPPRESS)
    options = parsed(parser, frames=200_000, rounds=1)
    warnings.simplefilter("ignore")  # of the peers
    if options.grow:
        print_growth(options.grow)
        return
    console = Console(width=110)
    with TemporaryDirectory() as name:
        measured = rows(Path(name), options.frames)
        for row in measured:
            row.ours.work()  # compiles and fills caches
        console.print(f"{options.frames} frames, medians of {options.rounds} rounds; {machine()}")
        console.print(table_of(measured, options.frames, options.rounds))
        for suffix in SUFFIXES:
            grown_mib = growth_mib(Path(name) / f"drive{suffix}")
            console.print(
                f"streaming {suffix} to columns: the process grows by {grown_mib:.1f} MiB past the first two batches"
            )


if __name__ == "__main__":
    main()
