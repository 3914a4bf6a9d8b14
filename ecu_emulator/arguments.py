"""The words of the command line: which commands there are, and which options each takes. Imports next to nothing."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Final

import click

from clutchdiag_io.command_line import FILE, FORCE, INT, Choice, Command, Option, Program
from clutchdiag_io.program import attached
from ecu_emulator.scenario import DriveName

PROGRAM: Final = "ecu-emulator"
EXIT_TEXT: Final = (
    "exit status: 0 done or stopped; 1 unexpected error; 2 usage, scenario or an extra that is not installed; 3 bus; "
    "4 file; 130, 143 a recording stopped early by SIGINT, SIGTERM; 130 interrupted twice"
)
_NS_PER_S: Final = 1_000_000_000  # not of clutch_model, which imports numpy
DEFAULT_REVS: Final = "4,4"
OIL_RANGE_DEGC: Final = (-15.0, 130.0)
MASS_RANGE_KG: Final = (900.0, 3500.0)
DELAY_RANGE_S: Final = (0.0, 3600.0)
MOST_PARKED_S: Final = 86_400.0
PARKED_RANGE_S: Final = (0.0, MOST_PARKED_S)
LIVE_PARKED_S: Final = 10.0
DEFAULT_START: Final = "2026-01-01T00:00:00Z"


def _rev_counts(text: str) -> tuple[int, int]:
    """Return the revs with open and with closed clutches; one number stands for both."""
    first, _, second = text.partition(",")
    if not (first.isdecimal() and (second or first).isdecimal()):
        raise ValueError(f"must be OPEN or OPEN,CLOSED, got {text}")
    return int(first), int(second or first)


def _between(low: float, high: float, unit: str) -> Callable[[str], float]:
    """Return a reader of numbers within a range."""

    def read(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise ValueError(f"must be {low:g}..{high:g} {unit}, got {text}")
        return value

    return read


def ns_of(instant: datetime) -> int:
    """Return nanoseconds since the epoch, whole microseconds; UTC unless it has a zone."""
    aware = instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)
    return int(aware.replace(microsecond=0).timestamp()) * _NS_PER_S + aware.microsecond * 1000


def _instant_ns(text: str) -> int:
    try:
        instant = datetime.fromisoformat(text)
    except ValueError as exc:
        raise ValueError(f"not an ISO 8601 time: {text}") from exc
    if (instant_ns := ns_of(instant)) < 0:
        raise ValueError(f"must not be before 1970: {text}")
    return instant_ns


_VERBOSE: Final = Option("-v --verbose", "show a traceback on errors")
_DRIVE: Final = (
    Option("--scenario NAME|FILE", "shipped scenario or TOML file", default="ideal"),
    Option("--fluid", "override the fluid", Choice(["ideal", "case1", "case2", "ageing"])),
    Option("--seed N", "override the seed of car and drive", INT),
    Option("--vehicle-seed N", "draw the car from this seed, not from --seed", INT),
    Option("--drive-seed N", "draw driver and noise from this one", INT),
    Option(
        "--cause NAME[:STRENGTH[:CLUTCH]]",
        "give the car a fault, such as glazed-lining:2, or several with commas between them; 1 is the smallest that "
        "matters; docs/verdict.md",
    ),
    Option(
        "--drive NAME",
        "what is driven: the shift cycle of a test bench (the default), a public cycle, city traffic by the seed, or a "
        "day of trips with the car parked in between",
        Choice([name.value for name in DriveName]),
    ),
    Option("--cycles N", "override how often it is driven: cycles, trips through the city, days", INT),
    Option("--endless", "drive again and again until stopped"),
    Option(
        "--oil-degc T",
        "temperature of the transmission oil when the drive begins; coolant and air are at most as warm; the shift "
        "cycle needs 40 degC",
        _between(*OIL_RANGE_DEGC, "degC"),
    ),
    Option("--mass-kg M", "override the mass of the car", _between(*MASS_RANGE_KG, "kg")),
    Option(
        "--odometer KM|TRUTH",
        "what the odometer reads at the start [km], or the truth file of the drive before, from whose end it goes on "
        "(default: 12345)",
    ),
    Option(
        "--routine [OPEN[,CLOSED]]",
        "begin with the workshop routine: number of revs in neutral with open, then with closed clutches "
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
    FORCE,
    Option("--control SOCKET", "take faults at run time on this Unix socket", FILE),
    *attached("ecu_emulator.answers").get("options", ()),
    Option("--alive FILE", "touch this file while frames go out", FILE),
    Option("--start-delay S", "wait before the first frame", _between(*DELAY_RANGE_S, "s"), default="0"),
    Option(
        "--parked S",
        "while the car is parked the bus is silent for at most this long; it cools down for all of its stay "
        f"(default: {LIVE_PARKED_S:g})",
        _between(*PARKED_RANGE_S, "s"),
        default=f"{LIVE_PARKED_S:g}",
    ),
    examples=(
        f"{PROGRAM} run -i socketcan -c vcan0",
        f"{PROGRAM} run -i socketcan -c vcan0 --fluid case2 --cycles 3 --truth truth.jsonl --json",
        f"{PROGRAM} run -i socketcan -c vcan0 --drive day --endless --oil-degc -10",
    ),
)
_RECORD: Final = Command(
    "record",
    "write a drive to a log file, faster than real time",
    click.Argument(["file"], type=FILE, metavar="FILE", help="log to write; - is standard output"),
    FORCE,
    Option(
        "--format",
        "default: by the file's suffix; candump on standard output",
        Choice(["candump", "blf", "asc", "mf4", "trc", "csv", "gvret"]),
    ),
    Option("--start-time ISO", f"default: {DEFAULT_START}", _instant_ns, default=DEFAULT_START),
    Option("-c --channel CHANNEL", "channel name in the log (default: vcan0)", default="vcan0"),
    *_DRIVE,
    Option("--truth FILE", "default: FILE.truth.jsonl beside the log; none beside standard output", FILE),
    Option(
        "--parked S",
        "while the car is parked the log has a gap of at most this long (default: as long as it is parked)",
        _between(*PARKED_RANGE_S, "s"),
        default=str(MOST_PARKED_S),
        show_default=False,
    ),
    examples=(
        f"{PROGRAM} record drive.log",
        f"{PROGRAM} record drive.blf --scenario case1 --cycles 5 --routine",
        f"{PROGRAM} record - --scenario case2 | diag-service analyze -",
        f"{PROGRAM} record cold.log --drive wltc --oil-degc 0 --mass-kg 1900",
    ),
)
_DBC: Final = Command(
    "dbc",
    "write the database of the emulated vehicle, for every program that reads DBC files",
    Option("-o --output FILE", "DBC file to write (default: standard output)", FILE),
    Option("--transmission NAME", "whose (default: nominal)", Choice(["nominal", "gs7", "lockup"]), default="nominal"),
    FORCE,
    _VERBOSE,
    examples=(f"{PROGRAM} dbc -o dct.dbc", f"{PROGRAM} dbc | cantools list -"),
)
COMMAND_LINE: Final = Program(
    PROGRAM,
    "Puts an emulated dual-clutch vehicle on a CAN bus or into a log.",
    EXIT_TEXT,
    _RUN,
    _RECORD,
    _DBC,
    Command(
        "scenarios",
        "list the scenarios that ship with the program",
        _VERBOSE,
        examples=(f"{PROGRAM} scenarios",),
    ),
)
