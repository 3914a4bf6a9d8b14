"""The command line of the emulator: commands with their options, signals and exit status."""

import math
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import update_wrapper
from threading import Event
from typing import TYPE_CHECKING, Any, Final

import click

from clutchdiag_io.command_line import CONTEXT, DISTRIBUTION, FILE, examples, force_option, record_of, together
from clutchdiag_io.command_line import run as run_command_line
from clutchdiag_io.program import attached, complain, refusal, standard_output
from ecu_emulator.errors import BusError, EmulatorConfigError, EmulatorStoppedError, LogFormatExtraError, RecordError
from ecu_emulator.scenario import (
    LIVE_PARKED_S,
    MASS_RANGE_KG,
    MOST_PARKED_S,
    OIL_RANGE_DEGC,
    PARKED_RANGE_S,
    DriveName,
)

if TYPE_CHECKING:
    from types import FrameType

PROGRAM: Final = "ecu-emulator"
STATUS_SIGNALLED: Final = 128  # and the number of the signal, as a shell tells it
STATUS_INTERRUPTED: Final = 130  # SIGINT again, without waiting for the clean stop
STATUSES: Final = (((EmulatorConfigError, LogFormatExtraError), 2), (BusError, 3), (RecordError, 4))
PATIENCE_S: Final = 1.0
EXIT_TEXT: Final = (
    "exit status: 0 done or stopped; 1 unexpected error; 2 usage, scenario or an extra that is not installed; 3 bus; "
    "4 file; 130, 143 a recording stopped early by SIGINT, SIGTERM; 130 interrupted twice"
)
DEFAULT_REVS: Final = "4,4"
FAULT_OPTIONS: Final = ("clutch", "strength", "quantity", "size", "message", "share", "duration_s")
DEFAULT_START: Final = "2026-01-01T00:00:00Z"
_ANSWERING: Final = attached("ecu_emulator.answers")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program and return its exit status."""
    with _stop_on_signals(is_program=arguments is None) as stop:
        try:
            return run_command_line(command_line, arguments, stop)
        except EmulatorStoppedError as exc:
            sys.stderr.write(f"{PROGRAM}: {exc}\n")
            words = sys.argv[1:] if arguments is None else arguments
            return 0 if words[0] == "run" else stop.status  # whose usual end is a signal
        except KeyboardInterrupt:
            sys.stderr.write(f"{PROGRAM}: error: interrupted\n")
            return STATUS_INTERRUPTED
        except Exception as exc:  # noqa: BLE001 - the one place where nothing may escape
            return complain(PROGRAM, exc, STATUSES)


class _Stop(Event):
    """Set by a signal, which it knows."""

    number: int | None = None

    @property
    def status(self) -> int:
        """The exit status of what a signal ended early."""
        return 0 if self.number is None else STATUS_SIGNALLED + self.number

    def check(self, _kernel: str) -> None:
        """Raise StoppedError if it is set: compiling can take minutes."""
        if self.is_set():
            raise EmulatorStoppedError("stopped early: numerical kernels were being compiled, nothing was driven")


def _working(function: Callable[..., None]) -> Callable[..., None]:
    """Have a command called with what stops it and its words, once libraries are loaded and compiling heeds signals."""

    def work(*, verbose: bool, **words: Any) -> None:
        with _without("asammdf"):  # python-can loads it where it is installed, and that pandas: 0.3 s for nothing
            import can  # noqa: F401 - heavy; signals are in hand before

            from canlog.jit import announce_compiling, on_compiling
        stop: _Stop = click.get_current_context().obj
        silence = announce_compiling(lambda line: sys.stderr.write(f"{PROGRAM}: {line}\n"))
        unheed = on_compiling(stop.check)
        try:
            with standard_output():
                function(stop, words)
        except Exception:
            if verbose:
                traceback.print_exc()
            raise
        finally:
            unheed()
            silence()  # a program that called this one prints nothing of its own

    return update_wrapper(work, function)


def _rev_counts(text: str) -> tuple[int, int]:
    """Return the revs with open and with closed clutches; one number stands for both."""
    first, _, second = text.partition(",")
    if not (first.isdecimal() and (second or first).isdecimal()):
        raise ValueError(f"must be OPEN or OPEN,CLOSED, got {text}")
    return int(first), int(second or first)


def _instant(text: str) -> datetime:
    """Return an instant, UTC unless it has a zone."""
    try:
        instant = datetime.fromisoformat(text)
    except ValueError as exc:
        raise ValueError(f"not an ISO 8601 time: {text}") from exc
    aware = instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)
    if aware.timestamp() < 0.0:
        raise ValueError(f"must not be before 1970: {text}")
    return aware


_verbose_option = click.option("-v", "--verbose", is_flag=True, help="show a traceback on errors")
_drive_options = together(
    click.option("--scenario", metavar="NAME|FILE", default="ideal", help="shipped scenario or TOML file"),
    click.option("--fluid", type=click.Choice(["ideal", "case1", "case2", "ageing"]), help="override the fluid"),
    click.option("--seed", type=int, help="override the seed of car and drive"),
    click.option("--vehicle-seed", type=int, help="draw the car from this seed, not from --seed"),
    click.option("--drive-seed", type=int, help="draw driver and noise from this one"),
    click.option(
        "--cause",
        metavar="NAME[:STRENGTH[:CLUTCH]]",
        help="give the car faults, such as glazed-lining:2, commas between them; 1 is the smallest that matters",
    ),
    click.option(
        "--drive",
        type=click.Choice([name.value for name in DriveName]),
        help="what is driven: a test bench's shift cycle, a public cycle, city traffic by the seed, or a day of trips",
    ),
    click.option("--cycles", type=int, help="override how often it is driven: cycles, trips through the city, days"),
    click.option("--endless", "is_endless", is_flag=True, help="drive again and again until stopped"),
    click.option(
        "--oil-degc",
        metavar="T",
        type=click.FloatRange(*OIL_RANGE_DEGC),
        help="temperature of the oil at the start; coolant and air are at most as warm; the shift cycle needs 40 degC",
    ),
    click.option("--mass-kg", metavar="M", type=click.FloatRange(*MASS_RANGE_KG), help="override the mass of the car"),
    click.option(
        "--odometer",
        "odometer_m",
        metavar="KM",
        type=lambda text: 1000.0 * float(text),
        help="odometer at the start [km] (default: 12345)",
    ),
    click.option(
        "--routine",
        metavar="[OPEN[,CLOSED]]",
        type=_rev_counts,
        is_flag=False,
        flag_value=DEFAULT_REVS,
        help="begin with the workshop routine: number of revs in neutral with open, then with closed clutches "
        f"({DEFAULT_REVS})",
    ),
    click.option("--json", "is_json", is_flag=True, help="print the result as one JSON line on stdout"),
    _verbose_option,
)


@click.group(PROGRAM, epilog=EXIT_TEXT, context_settings=CONTEXT, no_args_is_help=False)
@click.version_option(package_name=DISTRIBUTION, prog_name=PROGRAM, message="%(prog)s %(version)s")
def command_line() -> None:
    """Put an emulated dual-clutch vehicle on a CAN bus or into a log."""


@command_line.command(
    epilog=examples(
        f"{PROGRAM} run -i socketcan -c vcan0",
        f"{PROGRAM} run -i socketcan -c vcan0 --fluid case2 --cycles 3 --truth truth.jsonl --json",
        f"{PROGRAM} run -i socketcan -c vcan0 --drive day --endless --oil-degc -10",
    )
)
@click.option("-i", "--interface", help="python-can interface (default: can.conf, CAN_INTERFACE)")
@click.option("-c", "--channel", help="channel, e.g. vcan0 (default: can.conf, CAN_CHANNEL)")
@click.option("-b", "--bitrate", type=int, help="bit rate of a real interface [bit/s]")
@click.option("--fd", "is_fd", is_flag=True, help="open the interface in CAN FD mode")
@_drive_options
@click.option("--truth", type=FILE, help="write the truth about every shift to this file")
@force_option
@click.option(
    "--control",
    metavar="SOCKET",
    type=FILE,
    help="take orders of `control` at run time on this Unix socket",
)
@together(*_ANSWERING.get("options", ()))
@click.option("--alive", type=FILE, help="touch this file while frames go out")
@click.option(
    "--parked",
    "longest_stay_s",
    metavar="S",
    type=click.FloatRange(*PARKED_RANGE_S),
    default=f"{LIVE_PARKED_S:g}",
    help="while the car is parked the bus is silent for at most this long; it cools down for all of its stay",
)
@_working
def run(stop: _Stop, words: Mapping[str, Any]) -> None:
    """Stream a drive onto a CAN interface in real time."""
    from ecu_emulator import commands, live

    scenario = commands.choose_scenario(record_of(commands.DriveOptions, words))
    truth, others = words["truth"], (words["control"], words["alive"], words.get("diagnostic_memory"))
    if text := refusal(truth, is_forced=words["force"]) or refusal(truth, *others, is_forced=True):
        raise EmulatorConfigError(text)
    answers = _ANSWERING["chosen"](words) if _ANSWERING else None
    live.run(scenario, record_of(live.BusChoice, words), record_of(live.SendOptions, words), answers, stop)


@command_line.command(
    epilog=examples(
        f"{PROGRAM} record drive.log",
        f"{PROGRAM} record drive.blf --scenario case1 --cycles 5 --routine",
        f"{PROGRAM} record - --scenario case2 | diag-service analyze -",
        f"{PROGRAM} record cold.log --drive wltc --oil-degc 0 --mass-kg 1900",
    )
)
@click.argument("path", type=FILE, metavar="FILE", help="log to write; - is standard output")
@force_option
@click.option(
    "--format",
    "log_format",
    type=click.Choice(["candump", "blf", "mf4"]),
    help="default: by the file's suffix; candump on standard output",
)
@click.option("--start-time", metavar="ISO", type=_instant, default=DEFAULT_START, help="of the first frame")
@click.option("-c", "--channel", default="vcan0", help="channel name in the log")
@_drive_options
@click.option("--truth", type=FILE, help="default: FILE.truth.jsonl beside the log; none beside standard output")
@click.option(
    "--parked",
    "longest_stay_s",
    metavar="S",
    type=click.FloatRange(*PARKED_RANGE_S),
    default=str(MOST_PARKED_S),
    help="while the car is parked the log has a gap of at most this long",
)
@_working
def record(stop: _Stop, words: Mapping[str, Any]) -> None:
    """Write a drive to a log file, faster than real time."""
    from ecu_emulator import commands

    scenario = commands.choose_scenario(record_of(commands.DriveOptions, words))
    log = record_of(commands.LogOptions, {**words, "start_ns": commands.ns_of(words["start_time"])})
    if not commands.record(scenario, log, stop, is_json=words["is_json"], is_forced=words["force"]):
        click.get_current_context().exit(stop.status)


@command_line.command(
    epilog=examples(
        f"{PROGRAM} control /tmp/car fault glazed_lining --clutch 1 --strength 1.5",
        f"{PROGRAM} control /tmp/car fault offset --quantity engine_torque_nm --size 20 --duration 5",
        f"{PROGRAM} control /tmp/car code P0841",
        f"{PROGRAM} control /tmp/car engine off",
    )
)
@click.argument("socket", type=FILE, help="where the emulator listens")
@click.argument("order", type=click.Choice(["fault", "code", "engine", "trip", "gear"]), help="what to change")
@click.argument("name", metavar="KIND|CODE|on|off|end|GEAR", help="of the fault, the trouble code, ...")
@click.option("--clutch", type=int, help="1 or 2; without it the car's own weak one")
@click.option("--strength", type=float, help="of what is wrong with the car; 1 is the smallest that matters")
@click.option("--quantity", help="whose sensor errs, such as engine_torque_nm")
@click.option("--size", type=float, help="by how much, in the quantity's unit")
@click.option("--message", help="which message of the bus is struck, such as TCU_Shift (default: all)")
@click.option("--share", type=float, help="of its frames")
@click.option("--duration", "duration_s", metavar="S", type=float, help="how long (default: to the end of the drive)")
@_verbose_option
@_working
def control(_stop: _Stop, words: Mapping[str, Any]) -> None:
    """Give an order to an emulator that runs with --control SOCKET; a gear and the engine need a drive on the road."""
    from ecu_emulator.drive.orders import ask

    order, name = words["order"], words["name"]
    given = {key: words[key] for key in FAULT_OPTIONS if words[key] is not None}
    if order != "fault" and given:
        raise EmulatorConfigError(f"{', '.join(given)}: of a fault, not of {order}")
    word = int(name) if order == "gear" and name.isdecimal() else name
    sys.stdout.write(f"{ask(words['socket'], {'kind': name, **given} if order == 'fault' else {order: word})}\n")


@command_line.command(epilog=examples(f"{PROGRAM} dbc -o dct.dbc", f"{PROGRAM} dbc | cantools list -"))
@click.option("-o", "--output", type=FILE, help="DBC file to write (default: standard output)")
@click.option(
    "--transmission",
    metavar="NAME",
    type=click.Choice(["nominal", "gs7", "lockup"]),
    default="nominal",
    help="whose",
)
@force_option
@_verbose_option
@_working
def dbc(_stop: _Stop, words: Mapping[str, Any]) -> None:
    """Write the database of the emulated vehicle, for every program that reads DBC files."""
    from ecu_emulator import commands

    commands.save_dbc(words["output"], is_forced=words["force"], transmission=words["transmission"])


@command_line.command(epilog=examples(f"{PROGRAM} scenarios"))
@_verbose_option
@_working
def scenarios(_stop: _Stop, _words: Mapping[str, Any]) -> None:
    """List the scenarios that ship with the program."""
    from ecu_emulator import commands

    commands.list_scenarios()


@contextmanager
def _without(module: str) -> Iterator[None]:
    """Let a module seem not to be installed."""
    is_hidden = sys.modules.setdefault(module, None) is None  # type: ignore[arg-type]  # Python's own way to say so
    try:
        yield
    finally:
        if is_hidden:
            del sys.modules[module]


@contextmanager
def _stop_on_signals(*, is_program: bool) -> Iterator[_Stop]:
    """Turn SIGINT and SIGTERM into a request to stop; a SIGINT much later interrupts what does not heed it.

    A program ignores both in the end: one that comes while the interpreter winds down must not change the exit status.
    """
    stop = _Stop()
    deadline_s = math.inf

    def request(number: int, _frame: "FrameType | None") -> None:
        nonlocal deadline_s
        now_s = time.monotonic()
        if number == signal.SIGINT and now_s > deadline_s:
            raise KeyboardInterrupt
        stop.number = stop.number or number
        deadline_s = min(deadline_s, now_s + PATIENCE_S)  # a terminal and a wrapper may both hand on the same Ctrl-C
        stop.set()

    before = {number: signal.signal(number, request) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if is_program else handler)
