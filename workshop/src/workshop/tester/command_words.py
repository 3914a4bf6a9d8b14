"""The commands that ask controllers: dtc, did, routine, scan and try. What does the work is imported by who works."""

from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace
from typing import Final

import click

from clutchdiag_io.command_line import FILE, FLOAT, VERBOSE, Choice, Command, Option
from diag_service.service.stopping import Controls
from diag_service.settings.options import BUS, CONFIG, JSON, PROGRAM, VARIABLES


def _of(module: str, name: str) -> Callable[[SimpleNamespace, Controls], None]:
    """Return what carries out a command; its libraries, some of them compiled, are loaded when it is called."""

    def execute(options: SimpleNamespace, controls: Controls) -> None:
        getattr(import_module(f"workshop.tester.{module}"), name)(options, controls)

    return execute


_ASKED_BUS: Final = tuple(option for option in BUS if option.name in {"interface", "channel", "bitrate", "fd"})
_LISTENS: Final = (
    "Listens before it asks, and asks only with --active: without, it says what was heard on the bus and what it would "
    "ask. If another tester is heard, nothing is asked."
)
_ASKING: Final = (
    *_ASKED_BUS,
    Option("--doip HOST[:PORT]", "ask over IP (DoIP) instead of a bus; --ecu is the logical address then"),
    Option(
        "--doip-authority FILE",
        "over IP by TLS (port 3496 unless --doip names one), with a node whose certificate this authority (PEM) signed",
        FILE,
    ),
    Option("--ecu ID", "identifier of requests, hexadecimal (default: as described, or 7E1)"),
    Option("--reply ID", "identifier of answers (default: as described, or by the rules of the standard)"),
    Option("--address BYTE", "extended addressing: the address of the controller, hexadecimal"),
    Option("--active", "send requests"),
    Option("--listen S", "how long to listen before (default: 5)", FLOAT, default=5.0),
    Option("--timeout S", "how long an answer may take to begin (default: 1)", FLOAT, default=1.0),
)
_DESCRIPTION: Final = Option(
    "-d --description FILE",
    "what the controller has: TOML, PDX or the name of a shipped one (default: the shipped one that the controller "
    "says it is)",
    FILE,
)
_SESSION_TEXT: Final = "session to ask in, hexadecimal; the default session is restored at the end"
DTC: Final = Command(
    "dtc",
    "read the trouble codes of a controller, or clear them",
    *(*_ASKING, _DESCRIPTION),
    Option("--mask BYTE", "status bits of which a code must have one, hexadecimal (default: AF)", default="AF"),
    Option("--all", "all codes that the controller knows, also those that never failed"),
    Option("--readiness GROUP", "the codes of OBD in a readiness group (SAE J1979-2), hexadecimal, in place of --mask"),
    Option("--record N", "the codes that have a record of extended data, such as 91, hexadecimal, in place of --mask"),
    Option("--brief", "without snapshots and extended data"),
    Option(
        "--clear [GROUP]",
        "clear trouble codes and read what is left; a person before the terminal is asked first; GROUP: all (default), "
        "obd, a code such as P0811 or P0811-07, or three bytes in hexadecimal",
        flag_value="all",
    ),
    Option(
        "--session N",
        "session to clear in, hexadecimal; the default session is restored at the end (default: 01)",
        default="01",
    ),
    *(CONFIG, JSON, VERBOSE),
    variables=VARIABLES,
    description=f"Read the trouble codes of a controller, with what it kept of the failure, or clear them. {_LISTENS}",
    execute=_of("commands", "dtc"),
    examples=(
        f"{PROGRAM} dtc -i socketcan -c can0 --active",
        f"{PROGRAM} dtc -i socketcan -c can0 --ecu 18DA10F1 --description engine.pdx --active --json",
        f"{PROGRAM} dtc --doip 127.0.0.1 --ecu 1011 --active --brief",
        f"{PROGRAM} dtc -i socketcan -c can0 --active --clear",
    ),
)
DID: Final = Command(
    "did",
    "read data of a controller by identifier",
    click.Argument(["data"], nargs=-1, metavar="[DATA]...", help="numbers in hexadecimal, or names"),
    *(*_ASKING, _DESCRIPTION),
    Option("--session N", f"{_SESSION_TEXT} (default: 01)", default="01"),
    *(CONFIG, JSON, VERBOSE),
    variables=VARIABLES,
    description=f"Read data of a controller by identifier; without any, all that it is known to have. {_LISTENS}",
    execute=_of("commands", "did"),
    examples=(
        f"{PROGRAM} did F190 'fluid temperature' -i socketcan -c can0 --active",
        f"{PROGRAM} did --session 03 --description gearbox.toml -i socketcan -c can0 --active --json",
    ),
)
ROUTINE: Final = Command(
    "routine",
    "start or stop a routine of a controller, or read its results",
    click.Argument(["routine"], metavar="ROUTINE", help="number in hexadecimal, or name"),
    click.Argument(
        ["action"], type=Choice(["start", "stop", "results"]), metavar="ACTION", help="start, stop, results"
    ),
    *(*_ASKING, _DESCRIPTION),
    Option("--options BYTES", "options of the start, hexadecimal", default=""),
    Option(
        "--patience S",
        "how long a controller is given that says it takes longer, response pending (default: 600)",
        FLOAT,
        default=600.0,
    ),
    Option("--session N", f"{_SESSION_TEXT} (default: 03)", default="03"),
    Option("--unlock LEVEL=MASK", "unlock a security level whose key is the seed XOR this mask, hexadecimal"),
    *(CONFIG, JSON, VERBOSE),
    variables=VARIABLES,
    description=f"Start or stop a routine of a controller, or read its results. {_LISTENS}",
    execute=_of("commands", "routine"),
    examples=(f"{PROGRAM} routine 0301 start --options '02 02' --unlock 1=5AA5C33C -i socketcan -c can0 --active",),
)
SCAN: Final = Command(
    "scan",
    "find controllers and what they can be asked",
    *(option for option in _ASKING if option.name not in {"reply", "address"}),  # it finds both
    Option("--first ID", "first identifier, or address with --extended, hexadecimal (default: 700, or 00)"),
    Option("--last ID", "last identifier, or address with --extended, hexadecimal (default: 7FF, or FF)"),
    Option("--extended", "29-bit identifiers 18DAxxF1 instead of 11-bit ones"),
    Option("--wait S", "how long each may take to answer (default: 0.06)", FLOAT, default=0.06),
    Option("--all-data", "try all data F100 to F1FF, not only those that the standard names"),
    *(CONFIG, JSON, VERBOSE),
    variables=VARIABLES,
    description=(
        "Find the controllers on a bus and what each can be asked, by questions that change nothing, no "
        f"session either: tester present, data that identify it, the number of its trouble codes. {_LISTENS}"
    ),
    execute=_of("commands", "scan"),
    examples=(f"{PROGRAM} scan -i socketcan -c can0 --active", f"{PROGRAM} scan -c can0 --extended --active --json"),
)
TRY: Final = Command(
    "try",
    "find out what a car tells a tester, and how to go on",
    *_ASKED_BUS,
    Option("--adapter URL", "ask through elm327://HOST[:PORT], elm327:/dev/NAME or doip://HOST[:PORT]/ADDRESS"),
    Option("--profile FILE", "profile to try, a file or the name of a shipped one (default: all that ask)", FILE),
    Option("--dbc FILE", "database of what is broadcast", FILE),
    Option("--active", "send requests"),
    Option("--dry-run", "show the requests byte by byte and send nothing, whatever else is said"),
    Option("--listen S", "how long to listen before (default: 5)", FLOAT, default=5.0),
    Option("--record FILE", "record a drive (.log, .asc, .blf), learn the vehicle from it, and diagnose it", FILE),
    Option("--duration S", "how long that drive is (default: until Ctrl-C)", FLOAT),
    *(CONFIG, VERBOSE),
    variables=VARIABLES,
    description=(
        "Listen, ask for each signal of the profiles that ask, show the values and how many sets a second come, and "
        "say what that suffices for; with --record also after a drive. Only reading services are sent, and nothing "
        "without --active."
    ),
    execute=_of("trying", "try_car"),
    examples=(
        f"{PROGRAM} try -i socketcan -c can0 --active",
        f"{PROGRAM} try --adapter elm327:/dev/rfcomm0 --active --record drive.log",
    ),
)
