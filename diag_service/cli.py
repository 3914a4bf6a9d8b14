"""The command line of the service: words to configuration, errors to one line and an exit status."""

import argparse
import signal
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from clutch_model.errors import CalibrationError
from diag_service.defaults import BROKER_VARIABLE
from diag_service.errors import ConfigError, SourceError, StoreError
from diag_service.options import describe, fill_in
from diag_service.stopping import Trigger, ignore

if TYPE_CHECKING:
    from diag_service.publishers import BrokerAddress

PROGRAM = "diag-service"

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
    if options.command in {"run", "monitor"}:
        # python-can loads asammdf where it is installed: 45 MB of memory that only logs have a use for.
        sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # Python's own way to say "not here"
    # Imported here: compiled libraries take a second, in which a signal must already find its handler.
    from diag_service import application, config  # noqa: PLC0415 - see above
    from diag_service.notices import set_up_notices  # noqa: PLC0415 - see above
    from diag_service.publishers import Acknowledge  # noqa: PLC0415 - see above

    set_up_notices(options.verbose)
    fill_in(options)
    diagnosis = config.DiagnosisConfig(
        vehicle=config.check_vehicle(options.vehicle),
        dbc=options.dbc,
        profile=options.profile,
        calibration=config.load_calibration(options.calibration),
        broker=_broker(options),
        acknowledge=Acknowledge(options.acknowledge),
        budget_bytes=None if options.store_budget is None else options.store_budget << 20,
        is_strict=options.command == "analyze" and options.strict,
    )
    controls = application.Controls(stop=stop, counts_wanted=counts_wanted)
    if options.command == "analyze" and options.estimator == config.EstimatorKind.PAPER:
        config.check_paper_options(options.store, diagnosis.broker)
        application.run_paper_recorded(diagnosis, options.logs, controls, as_json=options.json)
        return
    if options.command == "analyze":
        application.run_recorded(diagnosis, options.logs, options.store, controls, as_json=options.json)
        return
    if options.command == "calibrate":
        application.run_calibrate(diagnosis, options.logs, options.output, controls, as_json=options.json)
        return
    bus = config.BusConfig(
        interface=options.interface,
        channel=options.channel,
        bitrate=options.bitrate,
        is_fd=options.fd,
        duration_s=options.duration,
        is_filtered=options.only_mapped,
        metrics=config.parse_listen_address(options.metrics) if options.metrics else None,
    )
    if options.command == "monitor":
        application.run_monitor(diagnosis, bus, controls)
        return
    store = options.store or config.default_store(diagnosis.vehicle)
    if options.command == "config":
        sys.stdout.write(describe(options))
        return
    application.run_bus(diagnosis, bus, store, controls, as_json=options.json)


def _broker(options: argparse.Namespace) -> "BrokerAddress | None":
    from diag_service import config  # noqa: PLC0415 - loads compiled libraries
    from diag_service.publishers import TlsFiles  # noqa: PLC0415 - see above

    tls = TlsFiles(authority=options.ca, certificate=options.cert, key=options.key)
    if options.broker:
        return config.parse_broker(options.broker, tls, options.password_file)
    if options.command not in {"calibrate", "monitor"} and (tls != TlsFiles() or options.password_file is not None):
        raise ConfigError("certificates and passwords need a broker")
    return None


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
    _add_bus(run)
    _add_common(run, "SQLite file for results (default: in the user's state directory, by vehicle)")

    monitor = commands.add_parser("monitor", help="show a live bus, store nothing", epilog=_EXIT_TEXT)
    _add_bus(monitor)
    _add_vehicle(monitor)
    monitor.set_defaults(broker="", acknowledge="broker")  # it delivers nothing

    settings = commands.add_parser("config", help="look at the settings", epilog=_EXIT_TEXT)
    check = settings.add_subparsers(dest="action", required=True, metavar="ACTION").add_parser(
        "check", help="check the settings and print what a run would use, secrets masked", epilog=_EXIT_TEXT
    )
    _add_bus(check)
    _add_common(check, "SQLite file for results")

    analyze = commands.add_parser("analyze", help="diagnose recorded logs of one drive", epilog=_EXIT_TEXT)
    analyze.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="log file of any known format")
    analyze.add_argument(
        "--estimator",
        choices=("impulse", "paper"),
        default="impulse",
        help="impulse: the service's own; paper: the method of SAE 2015-01-1146, without uncertainty and verdict",
    )
    analyze.add_argument(
        "--strict",
        action="store_true",
        help="stop at the first line or object that is no frame, jump of time or cut, and say where",
    )
    _add_common(analyze, "SQLite file for results (default: none, results are shown only)")

    calibrate = commands.add_parser(
        "calibrate", help="find one vehicle's sensor errors and inertia from its logs", epilog=_EXIT_TEXT
    )
    calibrate.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="logs of one vehicle, a drive or more")
    calibrate.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="calibration file to write (TOML)"
    )
    _add_vehicle(calibrate)
    calibrate.add_argument("--json", action="store_true", help="JSON on standard output")
    calibrate.set_defaults(broker="", acknowledge="broker")  # likewise
    return parser


def _add_bus(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-i", "--interface", help="python-can interface: socketcan, udp_multicast, ...")
    parser.add_argument("-c", "--channel", help="channel of the interface, such as vcan0")
    parser.add_argument("-b", "--bitrate", type=int, help="bit rate, for interfaces that set it [bit/s]")
    parser.add_argument("--fd", action="store_true", default=None, help="open the interface in CAN FD mode")
    parser.add_argument(
        "--only-mapped", action="store_true", default=None, help="let the kernel discard other messages, uncounted"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="stop after this many seconds")
    parser.add_argument(
        "--metrics", metavar="[HOST:]PORT", help="serve /metrics, /livez and /readyz there (default: nowhere)"
    )


def _add_vehicle(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dbc", type=Path, metavar="FILE", help="message database: DBC, KCD, ARXML or SYM (default: the shipped one)"
    )
    parser.add_argument("--profile", type=Path, metavar="FILE", help="which DBC signals are which (TOML)")
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="vehicle type (TOML; default: nominal)")
    parser.add_argument("--vehicle", metavar="ID", help="vehicle id (default: vehicle)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="TOML file with settings, see 'config check'")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice: libraries too")


def _add_common(parser: argparse.ArgumentParser, store_help: str) -> None:
    _add_vehicle(parser)
    parser.add_argument("--store", type=Path, metavar="FILE", help=store_help)
    parser.add_argument(
        "--broker",
        metavar="URL",
        help=f"mqtt[s]://[user[:password]@]host[:port] (default: the environment's {BROKER_VARIABLE}, else none)",
    )
    parser.add_argument("--ca", type=Path, metavar="FILE", help="authority of an mqtts:// broker (default: system)")
    parser.add_argument("--cert", type=Path, metavar="FILE", help="our certificate; a renewed one is taken up at once")
    parser.add_argument("--key", type=Path, metavar="FILE", help="its key, readable for its owner only")
    parser.add_argument("--password-file", type=Path, metavar="FILE", help="holds the broker's password, chmod 600")
    parser.add_argument(
        "--acknowledge",
        choices=("broker", "backend"),
        help="whose word lets the outbox forget a result; a backend gives it after its commit (default: broker)",
    )
    parser.add_argument(
        "--store-budget",
        type=int,
        metavar="MIB",
        help="how large the store may grow; delivered results go first, then empty ones (default: no limit)",
    )
    parser.add_argument("--json", action="store_true", help="JSON lines on standard output, text on standard error")
