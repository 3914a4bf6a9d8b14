"""The words of the command line: which commands there are, and which options each takes. Imports next to nothing."""

from collections.abc import Sequence
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Final

import click

from program_io.command_line import FILE, INT, Choice, Command, Option, Program, parse

PROGRAM: Final = "ecu-emulator"
EXIT_TEXT: Final = (
    "exit status: 0 done or stopped, 1 unexpected error, 2 usage, scenario or an extra that is not installed, 3 bus, "
    "4 file, 130 interrupted twice"
)
NS_PER_S: Final = 1_000_000_000
DEFAULT_REVS: Final = "4,4"
DEFAULT_START: Final = "2026-01-01T00:00:00Z"


def _rev_counts(text: str) -> tuple[int, int]:
    """Return the revs with open and with closed clutches; one number stands for both."""
    first, _, second = text.partition(",")
    if not (first.isdecimal() and (second or first).isdecimal()):
        raise ValueError(f"must be OPEN or OPEN,CLOSED, got {text}")
    return int(first), int(second or first)


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 3600.0:
        raise ValueError(f"must be 0..3600 s, got {text}")
    return value


def _instant_ns(text: str) -> int:
    """Return nanoseconds since the epoch, whole microseconds, of an ISO 8601 instant; UTC unless it says otherwise."""
    try:
        instant = datetime.fromisoformat(text)
    except ValueError as exc:
        raise ValueError(f"not an ISO 8601 time: {text}") from exc
    aware = instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)
    if aware < datetime(1970, 1, 1, tzinfo=UTC):
        raise ValueError(f"must not be before 1970: {text}")
    return int(aware.replace(microsecond=0).timestamp()) * NS_PER_S + aware.microsecond * 1000


_VERBOSE: Final = Option("-v", "--verbose", is_flag=True, help="show a traceback on errors")
_DRIVE: Final = (
    Option("--scenario", default="ideal", metavar="NAME|FILE", help="shipped scenario or TOML file"),
    Option("--fluid", type=Choice(["ideal", "case1", "case2", "ageing"]), help="override the fluid"),
    Option("--seed", type=INT, metavar="N", help="override the seed of car and drive"),
    Option("--vehicle-seed", type=INT, metavar="N", help="draw the car from this seed, not from --seed"),
    Option("--drive-seed", type=INT, metavar="N", help="draw driver and noise from this one"),
    Option("--cycles", type=INT, metavar="N", help="override the number of shift cycles"),
    Option(
        "--routine",
        type=_rev_counts,
        flag_value=DEFAULT_REVS,
        metavar="[OPEN[,CLOSED]]",
        help="begin with the workshop routine: so many revs in neutral with open, then with closed clutches "
        f"({DEFAULT_REVS})",
    ),
    Option("--json", is_flag=True, help="print the result as one JSON line on stdout"),
    _VERBOSE,
)
_RUN: Final = Command(
    "run",
    "stream a drive onto a CAN interface in real time",
    Option("-i", "--interface", help="python-can interface (default: can.conf, CAN_INTERFACE)"),
    Option("-c", "--channel", help="channel, e.g. vcan0 (default: can.conf, CAN_CHANNEL)"),
    Option("-b", "--bitrate", type=INT, help="bit rate of a real interface [bit/s]"),
    Option("--fd", is_flag=True, help="open the interface in CAN FD mode"),
    *_DRIVE,
    Option("--truth", type=FILE, metavar="FILE", help="write the truth about every shift to this file"),
    Option("--summary", type=FILE, metavar="FILE", help="write the transmit report to this file as JSON"),
    Option("--control", type=FILE, metavar="SOCKET", help="take faults at run time on this Unix socket"),
    Option("--alive", type=FILE, metavar="FILE", help="touch this file while frames go out"),
    Option("--start-delay", type=_seconds, default="0", metavar="S", help="wait before the first frame"),
    examples=(
        f"{PROGRAM} run -i socketcan -c vcan0",
        f"{PROGRAM} run -i socketcan -c vcan0 --fluid case2 --cycles 3 --truth truth.jsonl --json",
    ),
)
_RECORD: Final = Command(
    "record",
    "write a drive to a log file, faster than real time",
    click.Argument(["file"], type=FILE, metavar="FILE", help="log to write"),
    Option(
        "--format",
        type=Choice(["candump", "blf", "asc", "mf4", "trc", "csv", "gvret"]),
        help="default: by the file's suffix",
    ),
    Option("--start-time", type=_instant_ns, default=DEFAULT_START, metavar="ISO", help=f"default: {DEFAULT_START}"),
    Option("-c", "--channel", default="vcan0", help="channel name in the log (default: vcan0)"),
    *_DRIVE,
    Option("--truth", type=FILE, metavar="FILE", help="default: FILE.truth.jsonl beside the log"),
    examples=(
        f"{PROGRAM} record drive.log",
        f"{PROGRAM} record drive.blf --scenario case1 --cycles 5 --routine",
    ),
)
COMMAND_LINE: Final = Program(
    PROGRAM,
    "Puts an emulated dual-clutch vehicle on a CAN bus or into a log.",
    EXIT_TEXT,
    _RUN,
    _RECORD,
    Command(
        "scenarios",
        "list the scenarios that ship with the program",
        _VERBOSE,
        examples=(f"{PROGRAM} scenarios",),
    ),
)


def parse_arguments(words: Sequence[str] | None) -> SimpleNamespace:
    """Return what a command line says; raises SystemExit after help or a complaint."""
    return parse(COMMAND_LINE, words)
