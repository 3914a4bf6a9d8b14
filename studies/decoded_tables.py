"""What ``decode`` costs from the log to the file, beside python-can and cantools, which decode and write nothing.

A hundred messages with 700 signals, 651,360 frames, as candump text and as BLF; as MF4 beside a script of asammdf with
pyarrow, which writes a Parquet file for each message as ``--layout messages`` does. Every contender is a program of its
own; counted is the processor time of it and its children, user and system. The start of each, imports and database, is
what it takes for a log of a hundred frames. Contenders take turns; printed are the medians of the rounds and their
ratios: of whole programs, and with the starts taken off on both sides.

    python -m studies.decoded_tables [--frames 651360] [--rounds 3] [--format .log] [--format .blf] [--format .mf4]
"""

import resource
import statistics
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from rich.console import Console
from rich.table import Table

from studies.run import machine, parsed, study_parser
from studies.wide_bus import frames, write_database, write_log

FRAMES: Final = 651_360
SHORT: Final = 100  # frames of the log that a start is measured with
LEAST_S: Final = 0.01  # that differences of processor times can tell
LAYOUTS: Final = ("wide", "messages")
PEER: Final = """
import sys, can, cantools
decode = cantools.database.load_file(sys.argv[2]).decode_message
with can.LogReader(sys.argv[1]) as log:
    for message in log:
        decode(message.arbitration_id, bytes(message.data), decode_choices=False)
"""
MF4_PEER: Final = """
import sys, asammdf, pyarrow, pyarrow.parquet
with asammdf.MDF(sys.argv[1]) as log:
    signals = log.extract_bus_logging({"CAN": [(sys.argv[2], 0)]}, ignore_value2text_conversion=True)
for number, group in enumerate(signals.groups):
    found = [signals.get(group=number, index=place) for place in range(1, len(group.channels))]
    columns = {"time": found[0].timestamps, **{one.name: one.samples for one in found}}
    pyarrow.parquet.write_table(pyarrow.table(columns), f"{sys.argv[1]}-{number}.parquet", compression="zstd")
"""
FORMATS: Final = {".log": PEER, ".blf": PEER, ".mf4": MF4_PEER}


@dataclass(frozen=True, slots=True)
class Took:
    """What a program took: processor time for the log, and for its start alone."""

    whole_s: float
    start_s: float

    @property
    def net_s(self) -> float:
        """Processor time without the start, which varies by a tenth of a second: of one round it says little."""
        return self.whole_s - self.start_s


def program_s(words: list[str]) -> float:
    """Return the processor time of a program and its children [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def commands(log: Path, dbc: Path) -> dict[str, list[str]]:
    """Return the contenders: ours, each writing a table, and the peer."""
    ours = ["-m", "diag_service", "decode", str(log), "--dbc", str(dbc), "--force"]
    return {
        **{one: [*ours, "--layout", one, "-o", str(written(log, one))] for one in LAYOUTS},
        "peer": ["-c", FORMATS[log.suffix], str(log), str(dbc)],
    }


def written(log: Path, layout: str) -> Path:
    """Return the table, or the folder of tables, of a log."""
    return log.with_suffix(f".{layout}" if layout == "messages" else f".{layout}.parquet")


def one_round(log: Path, short: Path, dbc: Path) -> dict[str, Took]:
    """Return what every contender takes, in turns."""
    starts = {name: program_s(words) for name, words in commands(short, dbc).items()}
    return {name: Took(program_s(words), starts[name]) for name, words in commands(log, dbc).items()}


def add_rows(table: Table, log: Path, rounds: list[Mapping[str, Took]]) -> None:
    """Add what was measured on one log: medians of the rounds, and their ratios."""

    def median(name: str) -> Took:
        own = [each[name] for each in rounds]
        return Took(statistics.median(one.whole_s for one in own), statistics.median(one.start_s for one in own))

    peer = median("peer")
    table.add_row(log.suffix, "peer", *(f"{one:.2f}" for one in (peer.whole_s, peer.start_s, peer.net_s)))
    for name in LAYOUTS:
        ours = median(name)
        ratios = peer.whole_s / ours.whole_s, peer.net_s / max(ours.net_s, LEAST_S)
        output = written(log, name)
        files = [output] if output.is_file() else list(output.iterdir())
        size_mb = sum(file.stat().st_size for file in files) / 1e6
        table.add_row(
            log.suffix,
            name,
            *(f"{one:.2f}" for one in (ours.whole_s, ours.start_s, ours.net_s)),
            f"{size_mb:.1f}",
            *(f"1/{one:.1f}" for one in ratios),
        )


def main() -> None:
    """Run the benchmark."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each log (%(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="of which the medians are printed (%(default)s)")
    parser.add_argument("--format", action="append", choices=[*FORMATS], help="of the log (all)")
    options = parsed(parser, frames=100_000, rounds=1)
    console = Console(width=130)
    table = Table("log", "contender", "whole s", "start s", "net s", "MB", "of the peer", "net of starts")
    recorded = frames(options.frames)
    with TemporaryDirectory() as folder:
        dbc = write_database(Path(folder) / "bus.dbc")
        for suffix in options.format or FORMATS:
            log = write_log(Path(folder) / f"drive{suffix}", recorded)
            short = write_log(Path(folder) / f"short{suffix}", recorded[:SHORT])
            for words in commands(short, dbc).values():
                program_s(words)  # compiles, and fills the caches of files
            add_rows(table, log, [one_round(log, short, dbc) for _ in range(options.rounds)])
    console.print(f"{options.frames} frames, 700 signals; processor times, {options.rounds} rounds; {machine()}")
    console.print(table)


if __name__ == "__main__":
    main()
