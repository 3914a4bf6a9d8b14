"""The words of the command line: which commands and options there are. Needs no extra."""

import argparse
import os
from importlib.metadata import version
from pathlib import Path
from typing import Final, NoReturn

from fleet_backend.choices import Axis, Pace

PROGRAM: Final = "fleet-backend"
BROKER_VARIABLE: Final = "CLUTCHDIAG_BROKER"  # these keep passwords out of the process list
DATABASE_VARIABLE: Final = "CLUTCHDIAG_DATABASE"

EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_BROKER, EXIT_DATABASE, EXIT_UNKNOWN = range(6)
_EXIT_TEXT: Final = (
    "exit status: 0 done, stopped, or nobody reads on; 1 unexpected error, 2 usage or an extra that is not installed, "
    "3 broker, 4 database, 5 unknown vehicle"
)
_QUARANTINE_LIMIT: Final = 50


class Parser(argparse.ArgumentParser):
    """A parser that complains in one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        """Complain and leave."""
        self.exit(EXIT_CONFIG, f"{PROGRAM}: error: {message} (see {self.prog} --help)\n")


def build_parser() -> Parser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog=PROGRAM, description="Keeps the results of a fleet and answers questions about it.", epilog=_EXIT_TEXT
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version('clutchdiag')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)

    def add(name: str, text: str) -> argparse.ArgumentParser:
        return _with_common(commands.add_parser(name, help=text, description=text, epilog=_EXIT_TEXT))

    def add_question(name: str, text: str) -> argparse.ArgumentParser:
        command = add(name, text)
        command.add_argument("--json", action="store_true", help="one JSON object per line")
        command.add_argument(
            "--width",
            type=_count,
            metavar="N",
            help="columns to fit a table into (default: the terminal's, in a pipe any)",
        )
        return command

    _add_ingest(add("ingest", "take results from the broker into the database, until stopped"))
    add("migrate", "create the database, or bring it to the schema of this version")
    table = add_question("table", "show the running condition of every clutch, the worst first")
    table.add_argument("--limit", type=_count, metavar="N", help="show the N worst only")
    _add_trend(add_question("trend", "show how the friction of a clutch went"))
    _add_alarms(add_question("alarms", "show or acknowledge alarms"))
    _add_quarantine(add_question("quarantine", "show or forget messages that could not be used"))
    add_question("seen", "show when each vehicle was heard of")
    _add_fill(add("fill", "note that a vehicle got new fluid"))
    add("hash", "show a hash of all results: equal results, equal hash, in any database")
    return parser


def _with_common(command: argparse.ArgumentParser) -> argparse.ArgumentParser:
    command.add_argument(
        "--database",
        default=os.environ.get(DATABASE_VARIABLE),
        metavar="URL",
        help=f"postgresql://[user@]host[:port]/NAME or sqlite:///FILE (default: the environment's"
        f" {DATABASE_VARIABLE}, else an SQLite file in the user's state directory)",
    )
    command.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice: libraries too")
    return command


def _add_ingest(command: argparse.ArgumentParser) -> None:
    pace = Pace()
    command.add_argument(
        "--broker",
        default=os.environ.get(BROKER_VARIABLE),
        metavar="URL",
        help=f"mqtt[s]://[user[:password]@]host[:port], MQTT 5 (default: the environment's {BROKER_VARIABLE})",
    )
    command.add_argument("--ca", type=Path, metavar="FILE", help="certificate authority of an mqtts:// broker")
    command.add_argument("--cert", type=Path, metavar="FILE", help="our certificate, for mutual TLS")
    command.add_argument("--key", type=Path, metavar="FILE", help="its private key")
    command.add_argument("--worker", metavar="NAME", help="name of this worker, unlike any other's (default: made up)")
    command.add_argument(
        "--alive", type=Path, metavar="FILE", help="touch this file every 5 s while broker and database answer"
    )
    command.add_argument(
        "--batch",
        type=int,
        default=pace.batch_size,
        metavar="N",
        help="messages per transaction (default: %(default)s)",
    )
    command.add_argument(
        "--patience",
        type=float,
        default=pace.patience_s * 1000.0,
        metavar="MS",
        help="how long the first message of a batch waits for others (default: %(default)g)",
    )


def _add_trend(command: argparse.ArgumentParser) -> None:
    command.add_argument("vehicle", metavar="VEHICLE")
    command.add_argument("clutch", type=int, choices=(1, 2))
    command.add_argument(
        "--against", choices=[axis.value for axis in Axis], default=Axis.SHIFT.value, help="(default: %(default)s)"
    )


def _add_alarms(command: argparse.ArgumentParser) -> None:
    command.add_argument("--all", action="store_true", help="also those that are cleared")
    command.add_argument(
        "--acknowledge",
        metavar="VEHICLE",
        help="acknowledge the latest alarm of its --clutch, or without --clutch what was kept aside on its topics",
    )
    command.add_argument("--clutch", type=int, choices=(1, 2))
    command.add_argument("--by", metavar="WHO", help="who acknowledges (default: the user)")
    command.add_argument("--note", metavar="TEXT")


def _add_quarantine(command: argparse.ArgumentParser) -> None:
    command.add_argument("--limit", type=_count, default=_QUARANTINE_LIMIT, metavar="N", help="(default: %(default)s)")
    command.add_argument("--purge-days", type=float, metavar="D", help="forget what is older than D days instead")


def _add_fill(command: argparse.ArgumentParser) -> None:
    command.add_argument("vehicle", metavar="VEHICLE")
    command.add_argument("product", metavar="PRODUCT")
    command.add_argument("--at", metavar="DATE", help="ISO 8601, UTC without a zone (default: now)")
    command.add_argument("--odometer-km", type=float, metavar="KM")
    command.add_argument("--note", metavar="TEXT")


def _count(text: str) -> int:
    """Return how many lines are wanted; databases differ in what a negative number means."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a count, got {text}")
    return int(text)
