"""The words of the command line: which commands and options there are. Imports next to nothing."""

import argparse
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from diag_service.settings.defaults import BROKER_VARIABLE

PROGRAM = "diag-service"

EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_SOURCE, EXIT_STORE, EXIT_INCOMPLETE = range(6)
EXIT_SIGNALLED = 128  # and the number of the signal, as a shell tells it
_EXIT_TEXT = (
    "exit status: 0 done, 1 unexpected error, 2 usage, calibration, DBC or an extra that is not installed, "
    "3 bus or log, 4 store, 5 a log broke off and was not judged, or --strict was asked for and a log lost something "
    "or contributed nothing, "
    "130 stopped early by SIGINT, 143 by SIGTERM; run and monitor usually end by a signal: 0"
)
_FOLDERS = (
    "Logs that are named are one drive, put in order of time. A folder is many drives: every log in it, and in the "
    "folders below, is a drive of its own, judged for itself. With --output a folder that was left half-way, killed "
    "even, is taken up where it ended."
)
DEFAULT_BITRATE = 500_000


class Parser(argparse.ArgumentParser):
    """A parser that complains in one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        """Complain and leave."""
        self.exit(EXIT_CONFIG, f"{PROGRAM}: error: {message} (see {self.prog} --help)\n")


def build_parser() -> Parser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog=PROGRAM,
        description="Diagnoses wet dual clutches from their CAN traffic, shift by shift.",
        epilog=_EXIT_TEXT,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version('clutchdiag')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    _add_run(commands.add_parser("run", help="diagnose a live bus", epilog=_EXIT_TEXT))
    _add_monitor(commands.add_parser("monitor", help="show a live bus, store nothing", epilog=_EXIT_TEXT))
    _add_config(commands.add_parser("config", help="look at the settings", epilog=_EXIT_TEXT))
    _add_analyze(
        commands.add_parser(
            "analyze", help="diagnose recorded logs, or folders of them", description=_FOLDERS, epilog=_EXIT_TEXT
        )
    )
    _add_calibrate(
        commands.add_parser(
            "calibrate", help="find one vehicle's sensor errors and inertia from its logs", epilog=_EXIT_TEXT
        )
    )
    _add_inspect(commands.add_parser("inspect", help="show what traffic a log holds", epilog=_EXIT_TEXT))
    _add_signals(
        commands.add_parser("signals", help="list the signals in a log and propose a profile", epilog=_EXIT_TEXT)
    )
    _add_decode(commands.add_parser("decode", help="write the signals of a log as Parquet", epilog=_EXIT_TEXT))
    return parser


def _add_run(run: argparse.ArgumentParser) -> None:
    _add_bus(run)
    _add_meaning(run)
    _add_diagnosis(run, "SQLite file for results (default: in the user's state directory, by vehicle)")
    _add_verbosity(run)


def _add_monitor(monitor: argparse.ArgumentParser) -> None:
    _add_bus(monitor)
    _add_meaning(monitor)
    _add_verbosity(monitor)
    monitor.set_defaults(broker="", acknowledge="broker")  # it delivers nothing


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


def _add_config(settings: argparse.ArgumentParser) -> None:
    check = settings.add_subparsers(dest="action", required=True, metavar="ACTION").add_parser(
        "check", help="check the settings and print what a run would use, secrets masked", epilog=_EXIT_TEXT
    )
    _add_bus(check)
    _add_meaning(check)
    _add_diagnosis(check, "SQLite file for results")
    _add_verbosity(check)


def _add_analyze(analyze: argparse.ArgumentParser) -> None:
    analyze.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="log file, or folder of log files")
    analyze.add_argument(
        "--estimator",
        choices=("impulse", "paper"),
        default="impulse",
        help="impulse: the service's own; paper: the method of SAE 2015-01-1146, without uncertainty and verdict",
    )
    analyze.add_argument(
        "--strict",
        action="store_true",
        help="stop at the first line or object that is no frame, jump of time or cut, and say where; end with status 5 "
        "if a log or a channel contributed nothing",
    )
    analyze.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write the results to a .jsonl, .csv or .parquet file"
    )
    analyze.add_argument("--jobs", type=int, metavar="N", help="drives of folders at a time (default: one per core)")
    _add_meaning(analyze)
    _add_diagnosis(analyze, "SQLite file for results (default: none, results are shown only)")
    _add_verbosity(analyze)


def _add_calibrate(calibrate: argparse.ArgumentParser) -> None:
    calibrate.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="logs of one vehicle, a drive or more")
    calibrate.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="calibration file to write (TOML)"
    )
    _add_meaning(calibrate)
    calibrate.add_argument("--json", action="store_true", help="JSON on standard output")
    _add_verbosity(calibrate)
    calibrate.set_defaults(broker="", acknowledge="broker")  # likewise


def _add_inspect(inspect: argparse.ArgumentParser) -> None:
    inspect.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="log file")
    _add_database(inspect, "names messages; the shipped one also checks them")
    inspect.add_argument(
        "-b",
        "--bitrate",
        type=int,
        default=DEFAULT_BITRATE,
        help="bit rate that the bus load is told for [bit/s] (default: %(default)s)",
    )
    inspect.add_argument("--json", action="store_true", help="one JSON object on standard output")
    _add_verbosity(inspect)


def _add_signals(signals: argparse.ArgumentParser) -> None:
    signals.add_argument("log", type=Path, metavar="LOG", help="log file")
    _add_database(signals, "message database (default: the shipped one)")
    _add_verbosity(signals)


def _add_decode(decode: argparse.ArgumentParser) -> None:
    decode.add_argument("log", type=Path, metavar="LOG", help="log file")
    decode.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help="Parquet file to write")
    _add_database(decode, "message database (default: the shipped one)")
    decode.add_argument(
        "--layout",
        choices=("wide", "long"),
        default="wide",
        help="wide: a row per frame, a column per signal; long: a row per value (default: %(default)s)",
    )
    decode.add_argument(
        "--values",
        choices=("numbers", "texts", "both"),
        default="numbers",
        help="values that the database names: as numbers, as texts in a column beside, or both (default: %(default)s)",
    )
    decode.add_argument(
        "--strict",
        action="store_true",
        help="end with status 5 if anything of the log is not in the file, and say what",
    )
    decode.add_argument("--json", action="store_true", help="one JSON object on standard output")
    _add_verbosity(decode)


def _add_database(parser: argparse.ArgumentParser, text: str) -> None:
    parser.add_argument("--dbc", type=Path, metavar="FILE[#BUS]", help=text)
    parser.add_argument(
        "--lenient",
        action="store_true",
        default=None,
        help="leave out items of a DBC file that cannot be right, each with a warning, instead of refusing the file",
    )


def _add_meaning(parser: argparse.ArgumentParser) -> None:
    _add_database(parser, "message database: DBC, KCD, ARXML or SYM (default: the shipped one)")
    parser.add_argument(
        "--profile",
        type=Path,
        metavar="P",
        help="which DBC signals are which: TOML file or shipped name (default: the shipped one that fits the DBC)",
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="of a vehicle or its type (TOML; default: nominal)"
    )
    parser.add_argument("--vehicle", metavar="ID", help="vehicle id (default: the calibration's, or vehicle)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="TOML file with settings, see 'config check'")


def _add_diagnosis(parser: argparse.ArgumentParser, store_help: str) -> None:
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


def _add_verbosity(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice: libraries too")
