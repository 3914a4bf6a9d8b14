"""Command line of the emulator: arguments, signals and exit status; what the commands do is in ``commands``."""

import argparse
import math
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Final, NoReturn

from ecu_emulator import __version__
from ecu_emulator.errors import BusError, ConfigError, EmulatorError, ExtraMissingError, RecordError
from program_io.standard_output import standard_output

if TYPE_CHECKING:
    from types import FrameType

PROGRAM: Final = "ecu-emulator"
STATUS_UNEXPECTED: Final = 1
STATUS_INTERRUPTED: Final = 130  # SIGINT again, without waiting for the clean stop
STATUS_OF_ERROR: Final = {ConfigError: 2, ExtraMissingError: 2, BusError: 3, RecordError: 4}
EXIT_TEXT: Final = (
    "exit status: 0 done or stopped, 1 unexpected error, 2 usage, scenario or an extra that is not installed, 3 bus, "
    "4 file, 130 interrupted twice"
)
PATIENCE_S: Final = 1.0
NS_PER_S: Final = 1_000_000_000
DEFAULT_REVS: Final = (4, 4)
DEFAULT_START: Final = "2026-01-01T00:00:00Z"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program and return its exit status."""
    with _stop_on_signals(is_program=arguments is None) as stop:
        options = _parser().parse_args(arguments)
        try:
            with standard_output():
                _execute(options, stop)
        except EmulatorError as exc:
            return _fail(str(exc), STATUS_OF_ERROR.get(type(exc), STATUS_UNEXPECTED), verbose=options.verbose)
        except KeyboardInterrupt:
            return _fail("interrupted", STATUS_INTERRUPTED, verbose=False)
        except Exception as exc:  # noqa: BLE001 - the one place where nothing may escape
            text = f"unexpected {type(exc).__name__}: {exc}"
            return _fail(text, STATUS_UNEXPECTED, verbose=options.verbose)
    return 0


def _execute(options: argparse.Namespace, stop: Event) -> None:
    with _without("asammdf"):  # python-can loads it where it is installed, and that pandas: 0.3 s for nothing
        from canlog.compiling import tell_of_compiling  # noqa: PLC0415 - heavy; signals are in hand before
        from ecu_emulator import commands, live  # noqa: PLC0415 - likewise

    tell_of_compiling(lambda line: sys.stderr.write(f"{PROGRAM}: {line}\n"))
    if options.command == "scenarios":
        commands.list_scenarios()
        return
    scenario = commands.choose_scenario(
        options.scenario,
        fluid=options.fluid,
        seed=options.seed,
        vehicle_seed=options.vehicle_seed,
        drive_seed=options.drive_seed,
        cycles=options.cycles,
        routine=options.routine,
    )
    if options.command == "record":
        commands.record(
            scenario,
            path=options.file,
            log_format=options.format,
            start_ns=options.start_time,
            channel=options.channel,
            truth=options.truth,
            is_json=options.json,
            stop=stop,
        )
        return
    live.run(
        scenario,
        choice=live.BusChoice(
            interface=options.interface, channel=options.channel, bitrate=options.bitrate, is_fd=options.fd
        ),
        truth=options.truth,
        summary=options.summary,
        control=options.control,
        alive=options.alive,
        start_delay_s=options.start_delay,
        is_json=options.json,
        stop=stop,
    )


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
def _stop_on_signals(*, is_program: bool) -> Iterator[Event]:
    """Turn SIGINT and SIGTERM into a request to stop; a SIGINT much later interrupts what does not heed it.

    A program ignores both in the end: one that comes while the interpreter winds down must not change the exit status.
    """
    stop = Event()
    deadline_s = math.inf

    def request(number: int, _frame: "FrameType | None") -> None:
        nonlocal deadline_s
        now_s = time.monotonic()
        if number == signal.SIGINT and now_s > deadline_s:
            raise KeyboardInterrupt
        deadline_s = min(deadline_s, now_s + PATIENCE_S)  # a terminal and a wrapper may both hand on the same Ctrl-C
        stop.set()

    before = {number: signal.signal(number, request) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if is_program else handler)


def _fail(text: str, status: int, *, verbose: bool) -> int:
    from rich.console import Console  # noqa: PLC0415 - only when there is something to say

    console = Console(stderr=True, soft_wrap=True, highlight=False)
    if verbose:
        console.print_exception()
    console.print(f"{PROGRAM}: error: {text}", markup=False)
    return status


_FORMATS = ("candump", "blf", "asc", "mf4", "trc", "csv", "gvret")


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one clear line, whatever the subcommand."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROGRAM}: error: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog=PROGRAM, description="Puts an emulated dual-clutch vehicle on a CAN bus or into a log.", epilog=EXIT_TEXT
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_run(commands.add_parser("run", help="stream a drive onto a CAN interface in real time", epilog=EXIT_TEXT))
    _add_record(
        commands.add_parser("record", help="write a drive to a log file, faster than real time", epilog=EXIT_TEXT)
    )
    scenarios = commands.add_parser("scenarios", help="list the scenarios that ship with the program", epilog=EXIT_TEXT)
    scenarios.add_argument("-v", "--verbose", action="store_true", help="show a traceback on errors")
    return parser


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-i", "--interface", help="python-can interface (default: can.conf, CAN_INTERFACE)")
    parser.add_argument("-c", "--channel", help="channel, e.g. vcan0 (default: can.conf, CAN_CHANNEL)")
    parser.add_argument("-b", "--bitrate", type=int, help="bit rate of a real interface [bit/s]")
    parser.add_argument("--fd", action="store_true", help="open the interface in CAN FD mode")
    _add_drive(parser)
    parser.add_argument("--truth", type=Path, metavar="FILE", help="write the truth about every shift to this file")
    parser.add_argument("--summary", type=Path, metavar="FILE", help="write the transmit report to this file as JSON")
    parser.add_argument("--control", type=Path, metavar="SOCKET", help="take faults at run time on this Unix socket")
    parser.add_argument("--alive", type=Path, metavar="FILE", help="touch this file while frames go out")
    parser.add_argument("--start-delay", type=_seconds, default=0.0, metavar="S", help="wait before the first frame")


def _add_record(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="log to write")
    parser.add_argument("--format", choices=_FORMATS, help="default: by the file's suffix")
    parser.add_argument(
        "--start-time", type=_instant_ns, default=DEFAULT_START, metavar="ISO", help=f"default: {DEFAULT_START}"
    )
    parser.add_argument("-c", "--channel", default="vcan0", help="channel name in the log (default: vcan0)")
    _add_drive(parser)
    parser.add_argument("--truth", type=Path, metavar="FILE", help="default: FILE.truth.jsonl beside the log")


def _add_drive(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scenario", default="ideal", metavar="NAME|FILE", help="shipped scenario or TOML file")
    parser.add_argument("--fluid", choices=("ideal", "case1", "case2", "ageing"), help="override the fluid")
    parser.add_argument("--seed", type=int, metavar="N", help="override the seed of car and drive")
    parser.add_argument("--vehicle-seed", type=int, metavar="N", help="draw the car from this seed, not from --seed")
    parser.add_argument("--drive-seed", type=int, metavar="N", help="draw driver and noise from this one")
    parser.add_argument("--cycles", type=int, metavar="N", help="override the number of shift cycles")
    parser.add_argument(
        "--routine",
        type=_rev_counts,
        nargs="?",
        const=DEFAULT_REVS,
        metavar="OPEN[,CLOSED]",
        help="begin with the workshop routine: so many revs in neutral with open, then with closed clutches (4,4)",
    )
    parser.add_argument("--json", action="store_true", help="print the result as one JSON line on stdout")
    parser.add_argument("-v", "--verbose", action="store_true", help="show a traceback on errors")


def _rev_counts(text: str) -> tuple[int, int]:
    """Return the revs with open and with closed clutches; one number stands for both."""
    first, _, second = text.partition(",")
    if not (first.isdecimal() and (second or first).isdecimal()):
        raise argparse.ArgumentTypeError(f"must be OPEN or OPEN,CLOSED, got {text}")
    return int(first), int(second or first)


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 3600.0:
        raise argparse.ArgumentTypeError(f"must be 0..3600 s, got {text}")
    return value


def _instant_ns(text: str) -> int:
    """Return nanoseconds since the epoch, whole microseconds, of an ISO 8601 instant; UTC unless it says otherwise."""
    try:
        instant = datetime.fromisoformat(text)
    except ValueError as exc:
        raise argparse.ArgumentTypeError(f"not an ISO 8601 time: {text}") from exc
    aware = instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)
    if aware < datetime(1970, 1, 1, tzinfo=UTC):
        raise argparse.ArgumentTypeError(f"must not be before 1970: {text}")
    return int(aware.replace(microsecond=0).timestamp()) * NS_PER_S + aware.microsecond * 1000
