"""The command line of the backend: words to configuration, errors to one line and an exit status."""

import argparse
import getpass
import logging
import os
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from sqlalchemy import Engine

from fleet_backend import queries, report
from fleet_backend.application import run_ingest
from fleet_backend.broker import TlsFiles
from fleet_backend.config import parse_broker, parse_moment, parse_pace
from fleet_backend.database import default_database, open_database, place_of
from fleet_backend.errors import BrokerError, ConfigError, DatabaseError
from fleet_backend.ingest import Pace
from fleet_backend.migrate import check_schema, migrate, newest_revision
from fleet_contract import VariableError, check_variables

PROGRAM = "fleet-backend"
BROKER_VARIABLE = "CLUTCHDIAG_BROKER"  # these keep passwords out of the process list
DATABASE_VARIABLE = "CLUTCHDIAG_DATABASE"

EXIT_OK, EXIT_UNEXPECTED, EXIT_CONFIG, EXIT_BROKER, EXIT_DATABASE = range(5)
_EXIT_TEXT = "exit status: 0 done or stopped, 1 unexpected error, 2 usage, 3 broker, 4 database"
_QUARANTINE_LIMIT = 50

Command = Callable[[argparse.Namespace, Engine], None]


class _Parser(argparse.ArgumentParser):
    """A parser that complains in one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_CONFIG, f"{PROGRAM}: error: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the backend and return its exit status."""
    options = _parser().parse_args(arguments)
    _set_up_log(options.verbose)
    try:
        _check_environment()
        engine = open_database(options.database or default_database())
        command: Command = options.run
        try:
            command(options, engine)
        finally:
            engine.dispose()
    except KeyboardInterrupt:
        return EXIT_OK
    except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
        return _complain(exc, is_verbose=options.verbose > 0)
    return EXIT_OK


def _check_environment() -> None:
    try:
        check_variables(os.environ)
    except VariableError as exc:
        raise ConfigError(str(exc)) from exc


def _ingest(options: argparse.Namespace, engine: Engine) -> None:
    if not options.broker:
        raise ConfigError(f"no broker: give --broker or set {BROKER_VARIABLE}")
    tls = TlsFiles(ca=options.ca, certificate=options.cert, key=options.key)
    pace = parse_pace(options.batch, options.patience)
    run_ingest(engine, parse_broker(options.broker, tls), pace, options.worker)


def _migrate(_options: argparse.Namespace, engine: Engine) -> None:
    migrate(engine)
    sys.stdout.write(f"{place_of(engine)}: schema {newest_revision()}\n")


def _table(options: argparse.Namespace, engine: Engine) -> None:
    records = queries.worst_first(engine, options.limit)
    _tell(options, records, lambda: report.show(report.fleet_table(records), sys.stdout))


def _trend(options: argparse.Namespace, engine: Engine) -> None:
    records = queries.trend(engine, options.vehicle, options.clutch, queries.Axis(options.against))
    title = f"{options.vehicle}, clutch {options.clutch}: {len(records)} valid shifts against {options.against}"
    _tell(options, records, lambda: report.show(report.trend_table(title, records), sys.stdout))


def _alarms(options: argparse.Namespace, engine: Engine) -> None:
    if options.acknowledge is not None:
        vehicle, clutch = options.acknowledge, options.clutch
        by, now = options.by or getpass.getuser(), datetime.now(UTC)
        if clutch is None:
            count = queries.acknowledge_quarantine(engine, vehicle, by=by, at=now)
            sys.stdout.write(f"{count} messages on the topics of {vehicle} acknowledged\n")
        else:
            queries.acknowledge_clutch(engine, vehicle, clutch, by=by, note=options.note, at=now)
            sys.stdout.write(f"alarm of clutch {clutch} of {vehicle} acknowledged\n")
        return
    clutches = queries.clutch_alarms(engine, is_open_only=not options.all)
    identities = queries.identity_alarms(engine)
    records = [{"alarm": "clutch", **record} for record in clutches]
    records += [{"alarm": "identity", **record} for record in identities]
    _tell(options, records, lambda: report.show(report.alarm_table(clutches, identities), sys.stdout))


def _quarantine(options: argparse.Namespace, engine: Engine) -> None:
    if options.purge_days is not None:
        count = queries.purge_quarantine(engine, datetime.now(UTC) - timedelta(days=options.purge_days))
        sys.stdout.write(f"{count} messages forgotten\n")
        return
    records = queries.quarantined(engine, options.limit)
    _tell(options, records, lambda: report.show(report.quarantine_table(records), sys.stdout))


def _seen(options: argparse.Namespace, engine: Engine) -> None:
    records = queries.last_seen(engine)
    _tell(options, records, lambda: report.show(report.seen_table(records), sys.stdout))


def _fill(options: argparse.Namespace, engine: Engine) -> None:
    at = datetime.now(UTC) if options.at is None else parse_moment(options.at)
    odometer_m = None if options.odometer_km is None else options.odometer_km * 1000.0
    queries.note_fill(engine, options.vehicle, options.product, at=at, odometer_m=odometer_m, note=options.note)
    sys.stdout.write(f"{options.vehicle}: {options.product} since {at.isoformat()}\n")


def _hash(_options: argparse.Namespace, engine: Engine) -> None:
    found = queries.table_hash(engine)
    sys.stdout.write(f"{found.sha256}  {found.row_count} results\n")


def _checked(command: Command) -> Command:
    """Return a command that first makes sure of the schema; SQLite, which is ours alone, gets it."""

    def run(options: argparse.Namespace, engine: Engine) -> None:
        (migrate if engine.dialect.name == "sqlite" else check_schema)(engine)
        command(options, engine)

    return run


def _tell(options: argparse.Namespace, records: Sequence[report.Record], show: Callable[[], None]) -> None:
    if options.json:
        report.write_json(records, sys.stdout)
    else:
        show()


def _set_up_log(verbosity: int) -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter(f"%(asctime)s {PROGRAM}: %(levelname)s: %(message)s"))
    own = logging.getLogger("fleet_backend")
    own.handlers, own.propagate = [handler], False
    own.setLevel(logging.DEBUG if verbosity else logging.INFO)
    logging.getLogger().handlers = [handler] if verbosity > 1 else [logging.NullHandler()]


def _complain(exc: Exception, *, is_verbose: bool) -> int:
    """Write one line about an error, with ``-v`` also where it came from, and return the exit status."""
    status = EXIT_UNEXPECTED
    for kind, code in ((ConfigError, EXIT_CONFIG), (BrokerError, EXIT_BROKER), (DatabaseError, EXIT_DATABASE)):
        if isinstance(exc, kind):
            status = code
    text = " ".join(str(exc).split())
    if status == EXIT_UNEXPECTED:
        text = f"unexpected {type(exc).__name__}: {text}{'' if is_verbose else ' (-v shows where)'}"
    if is_verbose:
        import traceback  # noqa: PLC0415 - needed here only

        traceback.print_exception(exc)
    sys.stderr.write(f"{PROGRAM}: error: {text}\n")
    return status


def _parser() -> _Parser:
    parser = _Parser(prog=PROGRAM, description="Keeps the results of a fleet and answers questions about it.")
    parser.epilog = _EXIT_TEXT
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version('clutchdiag')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, run: Command, text: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text, epilog=_EXIT_TEXT)
        command.set_defaults(run=run)
        command.add_argument(
            "--database",
            default=os.environ.get(DATABASE_VARIABLE),
            metavar="URL",
            help=f"postgresql://[user@]host[:port]/NAME or sqlite:///FILE (default: the environment's"
            f" {DATABASE_VARIABLE}, else an SQLite file in the user's state directory)",
        )
        command.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice: libraries too")
        return command

    def add_question(name: str, run: Command, text: str) -> argparse.ArgumentParser:
        command = add(name, _checked(run), text)
        command.add_argument("--json", action="store_true", help="one JSON object per line")
        return command

    _add_ingest(add("ingest", _ingest, "take results from the broker into the database, until stopped"))
    add("migrate", _migrate, "bring the database to the schema of this version")
    table = add_question("table", _table, "show the running condition of every clutch, the worst first")
    table.add_argument("--limit", type=int, metavar="N", help="show the N worst only")
    _add_trend(add_question("trend", _trend, "show how the friction of a clutch went"))
    _add_alarms(add_question("alarms", _alarms, "show or acknowledge alarms"))
    _add_quarantine(add_question("quarantine", _quarantine, "show or forget messages that could not be used"))
    add_question("seen", _seen, "show when each vehicle was heard of")
    _add_fill(add("fill", _checked(_fill), "note that a vehicle got new fluid"))
    add("hash", _checked(_hash), "show a hash of all results: equal results, equal hash, in any database")
    return parser


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
        "--against", choices=[axis.value for axis in queries.Axis], default="shift", help="(default: %(default)s)"
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
    command.add_argument("--limit", type=int, default=_QUARANTINE_LIMIT, metavar="N", help="(default: %(default)s)")
    command.add_argument("--purge-days", type=float, metavar="D", help="forget what is older than D days instead")


def _add_fill(command: argparse.ArgumentParser) -> None:
    command.add_argument("vehicle", metavar="VEHICLE")
    command.add_argument("product", metavar="PRODUCT")
    command.add_argument("--at", metavar="DATE", help="ISO 8601, UTC without a zone (default: now)")
    command.add_argument("--odometer-km", type=float, metavar="KM")
    command.add_argument("--note", metavar="TEXT")
