"""The command line of the service: words to configuration, errors to one line and an exit status."""

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from clutch_model.errors import CalibrationError
from diag_service.errors import ConfigError, SourceError, StoreError
from diag_service.stopping import Trigger, ignore

PROGRAM = "diag-service"
BROKER_VARIABLE = "CLUTCHDIAG_BROKER"  # keeps a password out of the process list

EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_SOURCE, EXIT_STORE = range(5)
_EXIT_TEXT = "exit status: 0 done or stopped, 1 unexpected error, 2 usage, calibration or DBC, 3 bus or log, 4 store"


class _Parser(argparse.ArgumentParser):
    """A parser that complains in one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_CONFIG, f"{PROGRAM}: error: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the service and return its exit status."""
    stop, counts_wanted = Trigger(), Trigger()
    stop.listen_to(signal.SIGINT, signal.SIGTERM)
    counts_wanted.listen_to(signal.SIGUSR1)
    try:
        options = _parser().parse_args(arguments)
        try:
            _run(options, stop, counts_wanted)
        except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
            return _complain(exc, is_verbose=options.verbose > 0)
        return EXIT_OK
    finally:
        if arguments is None:  # a signal while the interpreter winds down must not change the exit status
            ignore(signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)


def _run(options: argparse.Namespace, stop: Trigger, counts_wanted: Trigger) -> None:
    if options.command == "run":
        # python-can loads asammdf where it is installed: 45 MB of memory that only logs have a use for.
        sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # Python's own way to say "not here"
    # Imported here: compiled libraries take a second, in which a signal must already find its handler.
    from diag_service import application, config  # noqa: PLC0415 - see above
    from diag_service.notices import set_up_notices  # noqa: PLC0415 - see above

    set_up_notices(options.verbose)
    diagnosis = config.DiagnosisConfig(
        vehicle=config.check_vehicle(options.vehicle),
        dbc=options.dbc,
        profile=options.profile,
        calibration=config.load_calibration(options.calibration),
        broker=config.parse_broker(options.broker) if options.broker else None,
    )
    controls = application.Controls(stop=stop, counts_wanted=counts_wanted)
    if options.command == "analyze" and options.estimator == config.EstimatorKind.PAPER:
        config.check_paper_options(options.store, diagnosis.broker)
        application.run_paper_recorded(diagnosis, options.logs, controls, as_json=options.json)
        return
    if options.command == "analyze":
        application.run_recorded(diagnosis, options.logs, options.store, controls, as_json=options.json)
        return
    bus = config.BusConfig(
        interface=options.interface,
        channel=options.channel,
        bitrate=options.bitrate,
        is_fd=options.fd,
        duration_s=options.duration,
    )
    store = options.store or config.default_store(diagnosis.vehicle)
    application.run_bus(diagnosis, bus, store, controls, as_json=options.json)


def _complain(exc: Exception, *, is_verbose: bool) -> int:
    """Write one line about an error, with ``-v`` also where it came from, and return the exit status."""
    status = EXIT_UNEXPECTED
    for kinds, code in (
        ((ConfigError, CalibrationError), EXIT_CONFIG),
        ((SourceError,), EXIT_SOURCE),
        ((StoreError,), EXIT_STORE),
    ):
        if isinstance(exc, kinds):
            status = code
    text = " ".join(str(exc).split())
    if status == EXIT_UNEXPECTED:
        hint = "" if is_verbose else " (-v shows where)"
        text = f"unexpected {type(exc).__name__}: {text}{hint}"
    if is_verbose:
        import traceback  # noqa: PLC0415 - needed here only

        traceback.print_exception(exc)
    sys.stderr.write(f"{PROGRAM}: error: {text}\n")
    return status


def _parser() -> _Parser:
    parser = _Parser(
        prog=PROGRAM,
        description="Diagnoses wet dual clutches from their CAN traffic, shift by shift.",
        epilog=_EXIT_TEXT,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version('clutchdiag')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="diagnose a live bus", epilog=_EXIT_TEXT)
    run.add_argument("-i", "--interface", help="python-can interface: socketcan, udp_multicast, ...")
    run.add_argument("-c", "--channel", help="channel of the interface, such as vcan0")
    run.add_argument("-b", "--bitrate", type=int, help="bit rate, for interfaces that set it [bit/s]")
    run.add_argument("--fd", action="store_true", help="open the interface in CAN FD mode")
    run.add_argument("--duration", type=float, metavar="S", help="stop after this many seconds")
    _add_common(run, "SQLite file for results (default: in the user's state directory, by vehicle)")

    analyze = commands.add_parser("analyze", help="diagnose recorded logs of one drive", epilog=_EXIT_TEXT)
    analyze.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="candump, BLF, ASC or MF4 file")
    analyze.add_argument(
        "--estimator",
        choices=("impulse", "paper"),
        default="impulse",
        help="impulse: the service's own; paper: the method of SAE 2015-01-1146, without uncertainty and verdict",
    )
    _add_common(analyze, "SQLite file for results (default: none, results are shown only)")
    return parser


def _add_common(parser: argparse.ArgumentParser, store_help: str) -> None:
    parser.add_argument("--dbc", type=Path, metavar="FILE", help="message database (default: the shipped one)")
    parser.add_argument("--profile", type=Path, metavar="P", help="which DBC signals are which: TOML file or name")
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="vehicle type (TOML; default: nominal)")
    parser.add_argument("--vehicle", default="vehicle", metavar="ID", help="vehicle id (default: %(default)s)")
    parser.add_argument("--store", type=Path, metavar="FILE", help=store_help)
    parser.add_argument(
        "--broker",
        default=os.environ.get(BROKER_VARIABLE),
        metavar="URL",
        help=f"mqtt://[user[:password]@]host[:port] (default: the environment's {BROKER_VARIABLE}, else none)",
    )
    parser.add_argument("--json", action="store_true", help="JSON lines on standard output, text on standard error")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice: libraries too")
