"""The commands that ask controllers: dtc, did, routine, scan and try. What does the work is imported by who works."""

from collections.abc import Callable
from typing import Any, Final

import click

from clutchdiag_io.command_line import FILE, FunctionT, examples, together
from diag_service.commands.options import PROGRAM, config_option, json_option, open_bus_options, working
from diag_service.stopping import Controls

_LISTENS: Final = (
    "Listens before it asks, and asks only with --active: without, it says what was heard on the bus and what it would "
    "ask. If another tester is heard, nothing is asked."
)
_active_option = click.option("--active", is_flag=True, help="send requests")
_listen_option = click.option("--listen", metavar="S", type=float, default=5.0, help="how long to listen before")
_asked_options = together(
    open_bus_options,
    click.option(
        "--doip", metavar="HOST[:PORT]", help="ask over IP (DoIP) instead of a bus; --ecu is the logical address then"
    ),
    click.option("--ecu", metavar="ID", help="identifier of requests, hexadecimal (default: as described, or 7E1)"),
    _active_option,
    _listen_option,
    click.option("--timeout", metavar="S", type=float, default=1.0, help="how long an answer may take to begin"),
)
_one_controller_options = together(
    _asked_options,
    click.option(
        "--reply", metavar="ID", help="identifier of answers (default: as described, or by the rules of the standard)"
    ),
    click.option("--address", metavar="BYTE", help="extended addressing: the address of the controller, hexadecimal"),
    click.option(
        "-d",
        "--description",
        type=FILE,
        help="what the controller has: TOML, PDX or the name of a shipped one (default: the one that it says it is)",
    ),
)
_ending_options = together(config_option, json_option)


def _session_option(text: str, default: str) -> Callable[[FunctionT], FunctionT]:
    return click.option(
        "--session",
        metavar="N",
        default=default,
        help=f"session to {text} in, hexadecimal; the default session is restored at the end",
    )


@click.command(
    short_help="Read the trouble codes of a controller, or clear them.",
    help=f"Read the trouble codes of a controller, with what it kept of the failure, or clear them. {_LISTENS}",
    epilog=examples(
        f"{PROGRAM} dtc -i socketcan -c can0 --active",
        f"{PROGRAM} dtc -i socketcan -c can0 --ecu 18DA10F1 --description engine.pdx --active --json",
        f"{PROGRAM} dtc --doip 127.0.0.1 --ecu 1011 --active --brief",
        f"{PROGRAM} dtc -i socketcan -c can0 --active --clear",
    ),
)
@_one_controller_options
@click.option("--mask", metavar="BYTE", default="AF", help="status bits of which a code must have one, hexadecimal")
@click.option(
    "--all", "has_all", is_flag=True, help="all codes that the controller knows, also those that never failed"
)
@click.option("--brief", is_flag=True, help="without snapshots and extended data")
@click.option(
    "--clear",
    metavar="[GROUP]",
    is_flag=False,
    flag_value="all",
    help="clear trouble codes, a person at the terminal is asked first: all, obd, P0811, P0811-07 or three hex bytes",
)
@_session_option("clear", "01")
@_ending_options
@working
def dtc(controls: Controls, **words: Any) -> None:
    from workshop.tester.commands import TroubleOptions, dtc

    dtc(TroubleOptions(**words), controls)


@click.command(
    short_help="Read data of a controller by identifier.",
    help=f"Read data of a controller by identifier; without any, all that it is known to have. {_LISTENS}",
    epilog=examples(
        f"{PROGRAM} did F190 'fluid temperature' -i socketcan -c can0 --active",
        f"{PROGRAM} did --session 03 --description gearbox.toml -i socketcan -c can0 --active --json",
    ),
)
@click.argument("data", nargs=-1, metavar="[DATA]...", help="numbers in hexadecimal, or names")
@_one_controller_options
@_session_option("ask", "01")
@_ending_options
@working
def did(controls: Controls, **words: Any) -> None:
    from workshop.tester.commands import DataOptions, did

    did(DataOptions(**words), controls)


@click.command(
    short_help="Start or stop a routine of a controller, or read its results.",
    help=f"Start or stop a routine of a controller, or read its results. {_LISTENS}",
    epilog=examples(
        f"{PROGRAM} routine 0301 start --options '02 02' --unlock 1=5AA5C33C -i socketcan -c can0 --active"
    ),
)
@click.argument("routine", metavar="ROUTINE", help="number in hexadecimal, or name")
@click.argument(
    "action", type=click.Choice(["start", "stop", "results"]), metavar="ACTION", help="start, stop, results"
)
@_one_controller_options
@click.option("--options", "start_options", metavar="BYTES", default="", help="options of the start, hexadecimal")
@_session_option("ask", "03")
@click.option(
    "--unlock", metavar="LEVEL=MASK", help="unlock a security level whose key is the seed XOR this mask, hexadecimal"
)
@_ending_options
@working
def routine(controls: Controls, **words: Any) -> None:
    from workshop.tester.commands import RoutineOptions, routine

    routine(RoutineOptions(**words), controls)


@click.command(
    short_help="Find controllers and what they can be asked.",
    help="Find the controllers on a bus and what each can be asked, by questions that change nothing, no session "
    f"either: tester present, data that identify it, the number of its trouble codes. {_LISTENS}",
    epilog=examples(
        f"{PROGRAM} scan -i socketcan -c can0 --active", f"{PROGRAM} scan -c can0 --extended --active --json"
    ),
)
@_asked_options
@click.option(
    "--first", metavar="ID", help="first identifier, or address with --extended, hexadecimal (default: 700, or 00)"
)
@click.option(
    "--last", metavar="ID", help="last identifier, or address with --extended, hexadecimal (default: 7FF, or FF)"
)
@click.option("--extended", is_flag=True, help="29-bit identifiers 18DAxxF1 instead of 11-bit ones")
@click.option("--wait", metavar="S", type=float, default=0.06, help="how long each may take to answer")
@click.option("--all-data", is_flag=True, help="try all data F100 to F1FF, not only those that the standard names")
@_ending_options
@working
def scan(controls: Controls, **words: Any) -> None:
    from workshop.tester.commands import ScanOptions, scan

    scan(ScanOptions(**words), controls)


@click.command(
    "try",
    epilog=examples(
        f"{PROGRAM} try -i socketcan -c can0 --active",
        f"{PROGRAM} try --adapter elm327:/dev/rfcomm0 --active --record drive.log",
    ),
)
@open_bus_options
@click.option(
    "--adapter", metavar="URL", help="ask through elm327://HOST[:PORT], elm327:/dev/NAME or doip://HOST[:PORT]/ADDRESS"
)
@click.option(
    "--profile", type=FILE, help="profile to try, a file or the name of a shipped one (default: all that ask)"
)
@click.option("--dbc", type=FILE, help="database of what is broadcast")
@_active_option
@click.option("--dry-run", is_flag=True, help="show the requests byte by byte and send nothing, whatever else is said")
@_listen_option
@click.option(
    "--patience", metavar="S", type=float, default=60.0, help="how long a controller that is busy is asked again"
)
@click.option(
    "--record", type=FILE, help="record a drive (.log, .asc, .blf), learn the vehicle from it, and diagnose it"
)
@click.option("--duration", metavar="S", type=float, help="how long that drive is (default: until Ctrl-C)")
@config_option
@working
def try_car(controls: Controls, **words: Any) -> None:
    """Find out what a car tells a tester, and how to go on.

    Listen, ask for each value of the profiles that ask, show what the car answers by the best of them and how fast, and
    say what that suffices for; with --record also after a drive. -v shows every answer. Only reading services are sent,
    and nothing without --active.
    """
    from workshop.tester.trying import TryOptions, try_car

    try_car(TryOptions(**words), controls)
