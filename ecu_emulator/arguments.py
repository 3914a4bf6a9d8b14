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


_VERBOSE: Final = Option("-v --verbose", "show a traceback on errors")
_DRIVE: Final = (
    Option("--scenario NAME|FILE", "shipped scenario or TOML file", default="ideal"),
    Option("--fluid", "override the fluid", Choice(["ideal", "case1", "case2", "ageing"])),
    Option("--seed N", "override the seed of car and drive", INT),
    Option("--vehicle-seed N", "draw the car from this seed, not from --seed", INT),
    Option("--drive-seed N", "draw driver and noise from this one", INT),
    Option("--cycles N", "override the number of shift cycles", INT),
    Option(
        "--routine [OPEN[,CLOSED]]",
        "begin with the workshop routine: so many revs in neutral with open, then with closed clutches "
        f"({DEFAULT_REVS})",
        _rev_counts,
        flag_value=DEFAULT_REVS,
    ),
    Option("--json", "print the result as one JSON line on stdout"),
    _VERBOSE,
)
_RUN: Final = Command(
    "run",
    "stream a drive onto a CAN interface in real time",
    Option("-i --interface INTERFACE", "python-can interface (default: can.conf, CAN_INTERFACE)"),
    Option("-c --channel CHANNEL", "channel, e.g. vcan0 (default: can.conf, CAN_CHANNEL)"),
    Option("-b --bitrate BITRATE", "bit rate of a real interface [bit/s]", INT),
    Option("--fd", "open the interface in CAN FD mode"),
    *_DRIVE,
    Option("--truth FILE", "write the truth about every shift to this file", FILE),
    Option("--summary FILE", "write the transmit report to this file as JSON", FILE),
    Option("--control SOCKET", "take faults at run time on this Unix socket", FILE),
    Option(
        "--diagnostics [TABLE]",
        "answer UDS requests of testers (7E1, 7DF); TABLE: a controller of your own instead of the one that ships",
        flag_value="",
    ),
    Option("--diagnostic-memory FILE", "keep trouble codes in this file, over restarts", FILE),
    Option("--alive FILE", "touch this file while frames go out", FILE),
    Option("--start-delay S", "wait before the first frame", _seconds, default="0"),
    examples=(
        f"{PROGRAM} run -i socketcan -c vcan0",
        f"{PROGRAM} run -i socketcan -c vcan0 --diagnostics --diagnostic-memory tcu.json",
        f"{PROGRAM} run -i socketcan -c vcan0 --fluid case2 --cycles 3 --truth truth.jsonl --json",
    ),
)
_RECORD: Final = Command(
    "record",
    "write a drive to a log file, faster than real time",
    click.Argument(["file"], type=FILE, metavar="FILE", help="log to write"),
    Option(
        "--format", "default: by the file's suffix", Choice(["candump", "blf", "asc", "mf4", "trc", "csv", "gvret"])
    ),
    Option("--start-time ISO", f"default: {DEFAULT_START}", _instant_ns, default=DEFAULT_START),
    Option("-c --channel CHANNEL", "channel name in the log (default: vcan0)", default="vcan0"),
    *_DRIVE,
    Option("--truth FILE", "default: FILE.truth.jsonl beside the log", FILE),
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
