"""The commands of the backend, and the options that they share; those of the office are in ``office.commands``."""

import getpass
import logging
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from functools import update_wrapper
from pathlib import Path
from typing import Any, Final

import click
from rich.table import Table
from sqlalchemy import Engine

from clutchdiag_io.command_line import CONTEXT, DISTRIBUTION, FILE, examples, together
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.program import standard_output
from fleet_backend import config, months, queries, report
from fleet_backend import migrate as migrations
from fleet_backend.application import run_ingest
from fleet_backend.choices import BROKER_VARIABLE, DATABASE_VARIABLE, GROUP_VARIABLE, Pace, TrendAxis
from fleet_backend.database import default_database, open_database, place_of
from fleet_backend.errors import BackendConfigError
from fleet_backend.follow import follow as follow_broker
from fleet_contract import check_variables

PROGRAM: Final = "fleet-backend"
_EXIT_TEXT: Final = (
    "exit status: 0 done, stopped, or the reader closed the pipe; 1 unexpected error; 2 usage or an extra that is not "
    "installed; 3 broker; 4 database; 5 unknown vehicle"
)
_PACE: Final = Pace()
_MAX_BATCH: Final = 30_000  # twice as many are in flight; MQTT counts to 65,535
COUNT: Final = click.IntRange(min=0)  # databases differ in what a negative number means


def _set_up_log(verbosity: int) -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter(f"%(asctime)s {PROGRAM}: %(levelname)s: %(message)s"))
    for name in ("fleet_backend", "fleet_link", "clutchdiag_io", "uvicorn"):
        logger = logging.getLogger(name)
        logger.handlers, logger.propagate = [handler], False
        logger.setLevel(logging.DEBUG if verbosity else logging.INFO)
    if not verbosity:
        logging.getLogger("uvicorn").setLevel(logging.WARNING)  # that it starts is said already
    logging.getLogger().handlers = [handler] if verbosity > 1 else [logging.NullHandler()]


_verbose_option = click.option(
    "-v", "--verbose", count=True, show_default=False, help="print more; twice: of libraries"
)
json_option = click.option("--json", "is_json", is_flag=True, help="one JSON object per line")
_tls_options = together(
    click.option("--ca", type=FILE, help="certificate authority of an mqtts:// broker"),
    click.option("--cert", type=FILE, help="our certificate, for mutual TLS"),
    click.option("--key", type=FILE, help="its private key"),
)
metrics_option = click.option(
    "--metrics", metavar="ADDRESS", help="serve metrics for Prometheus at HOST:PORT, a loopback address"
)
vehicle_argument = click.argument("vehicle", metavar="VEHICLE", help="vehicle id")


def address_of() -> str:
    """Return the address of the database of the command that is at work."""
    return click.get_current_context().params["database"] or default_database()


def of_database(
    *, must_exist: bool = True, is_made_ready: bool = True
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Have a command called with the database and its words.

    A database must be there, since a mistyped name must not become an empty fleet, and has its schema made ready.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        def work(*, database: str | None, verbose: int, **words: Any) -> None:  # noqa: ANN401 - of all kinds
            del database  # whoever needs its address again asks for it
            _set_up_log(verbose)
            check_variables(os.environ)
            for name in ("vehicle", "acknowledge", "product", "note", "by"):
                if not str(words.get(name) or "").isprintable():
                    raise BackendConfigError(f"{name} holds characters that are not text")
            engine = open_database(address_of(), must_exist=must_exist)
            try:
                with standard_output():
                    if is_made_ready:
                        migrations.make_ready(engine)
                    function(engine, **words)
            finally:
                engine.dispose()

        return update_wrapper(work, function)

    return together(
        click.option(
            "--database",
            metavar="URL",
            envvar=DATABASE_VARIABLE,
            help="postgresql://[user@]host[:port]/NAME or sqlite:///FILE (default: the environment's "
            f"{DATABASE_VARIABLE}, else an SQLite file in the user's state directory)",
        ),
        _verbose_option,
        decorate,
    )


def metrics_at(place: str | None) -> config.ServerAddress | None:
    return None if place is None else config.parse_listen(place, option="--metrics")


def user_name() -> str:
    """Return who runs this, for the audit; a container's user may have no name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid {os.getuid()}"


def print_records(records: Sequence[report.Record], sheet: Callable[[], Table], *, is_json: bool) -> None:
    if is_json:
        report.write_json(records, sys.stdout)
    else:
        PeopleConsole().print(sheet())


@click.group(PROGRAM, epilog=_EXIT_TEXT, context_settings=CONTEXT, no_args_is_help=False)
@click.version_option(package_name=DISTRIBUTION, prog_name=PROGRAM, message="%(prog)s %(version)s")
def command_line() -> None:
    """Keep the results of a fleet and answer questions about it."""


@command_line.command(
    epilog=examples(
        f"{PROGRAM} ingest --broker mqtts://fleet@broker.example --database postgresql://fleet@db.example/fleet"
    )
)
@click.option(
    "--broker",
    metavar="URL",
    envvar=BROKER_VARIABLE,
    help="mqtt[s]://[user[:password]@]host[:port], MQTT 5, or nats[+tls]://... with JetStream (default: the "
    f"environment's {BROKER_VARIABLE})",
)
@_tls_options
@click.option("--worker", metavar="NAME", help="unique name of this worker (default: generated)")
@click.option(
    "--group",
    metavar="NAME",
    default="ingest",
    envvar=GROUP_VARIABLE,
    help="of workers that share what an MQTT broker sends; better a secret that no vehicle can guess (default: the "
    f"environment's {GROUP_VARIABLE}, else ingest)",
)
@click.option("--alive", type=FILE, help="touch this file every 5 s while broker and database answer")
@metrics_option
@click.option("--batch", type=click.IntRange(1, _MAX_BATCH), default=_PACE.batch_size, help="results per transaction")
@click.option(
    "--patience",
    metavar="MS",
    type=click.IntRange(0, 10_000),
    default=int(_PACE.patience_s * 1000.0),
    help="how long the first message of a batch waits for others",
)
@click.option(
    "--quotas",
    metavar="R,Q,MB",
    default="100000,1000,500",
    help="taken of a vehicle in a day (UTC): results, unusable messages, megabytes; 0: any; it keeps what is beyond",
)
@click.option(
    "--no-bundles",
    is_flag=True,
    help="ask vehicles to send each result in a message of its own, for other readers of the topic shift",
)
@of_database(is_made_ready=False)
def ingest(
    engine: Engine,
    *,
    broker: str | None,
    ca: Path | None,
    cert: Path | None,
    key: Path | None,
    worker: str | None,
    group: str,
    alive: Path | None,
    metrics: str | None,
    batch: int,
    patience: int,
    quotas: str,
    no_bundles: bool,
) -> None:
    """Take results from the broker into the database, until stopped."""
    pace = Pace(batch_size=batch, patience_s=patience / 1000.0, takes_bundles=not no_bundles)
    if not broker:
        raise BackendConfigError(f"no broker: give --broker or set {BROKER_VARIABLE}")
    run_ingest(
        engine,
        config.parse_broker(broker, ca=ca, certificate=cert, key=key, may_be_nats=True),
        pace,
        worker,
        alive,
        group=config.parse_group(group),
        quotas=config.parse_quotas(quotas),
        metrics=metrics_at(metrics),
    )


@command_line.command(epilog=examples(f"{PROGRAM} migrate --database sqlite:///fleet.sqlite"))
@of_database(must_exist=False, is_made_ready=False)
def migrate(engine: Engine) -> None:
    """Create the database, or bring it to the schema of this version."""
    migrations.migrate(engine)
    sys.stdout.write(f"{place_of(engine)}: schema {migrations.newest_revision()}\n")


@command_line.command(
    epilog=examples(
        f"{PROGRAM} follow mqtt://localhost", f"{PROGRAM} follow mqtts://fleet@broker.example car1 car2 --json"
    )
)
@click.argument("broker", metavar="BROKER", help=f"mqtt[s]://[user[:password]@]host[:port]; -: {BROKER_VARIABLE}")
@click.argument("vehicles", nargs=-1, metavar="[VEHICLE...]", help="only these")
@json_option
@_tls_options
@_verbose_option
def follow(
    *, broker: str, vehicles: tuple[str, ...], ca: Path | None, cert: Path | None, key: Path | None, is_json: bool,
    verbose: int
) -> None:  # fmt: skip
    """Show what vehicles find as it arrives, until Ctrl-C; needs no database."""
    _set_up_log(verbose)
    check_variables(os.environ)
    with standard_output():
        follow_broker(broker=broker, vehicles=vehicles, ca=ca, cert=cert, key=key, is_json=is_json)


@command_line.command(epilog=examples(f"{PROGRAM} table --limit 10"))
@json_option
@click.option("--limit", type=COUNT, help="show only the N worst")
@of_database()
def table(engine: Engine, *, limit: int | None, is_json: bool) -> None:
    """Show the running condition of every clutch, the worst first."""
    records = queries.with_distances(engine, queries.worst_first(engine, limit))
    print_records(records, lambda: report.fleet_table(records), is_json=is_json)


@command_line.command(epilog=examples(f"{PROGRAM} trend car1 2 --against odometer"))
@vehicle_argument
@click.argument("clutch", type=click.Choice([1, 2]), metavar="CLUTCH", help="1 or 2")
@json_option
@click.option(
    "--against",
    type=click.Choice([axis.value for axis in TrendAxis]),
    default=TrendAxis.SHIFT.value,
    help="what the trend is shown over",
)
@of_database()
def trend(engine: Engine, *, vehicle: str, clutch: int, against: str, is_json: bool) -> None:
    """Show how the friction of a clutch went."""
    queries.check_vehicle(engine, vehicle)
    records = queries.trend(engine, vehicle, clutch, TrendAxis(against))
    whose = f"{vehicle}, {queries.clutch_name(engine, vehicle, clutch)}"
    title = f"{whose}: {len(records)} valid shifts against {against}"
    print_records(records, lambda: report.trend_table(title, records), is_json=is_json)


@command_line.command(epilog=examples(f"{PROGRAM} quarantine --purge-days 90"))
@json_option
@click.option("--limit", type=COUNT, default=50, help="show only the N latest")
@click.option("--purge-days", metavar="D", type=float, help="delete messages older than D days instead")
@of_database()
def quarantine(engine: Engine, *, limit: int, purge_days: float | None, is_json: bool) -> None:
    """Show or forget messages that could not be used."""
    if purge_days is not None:
        now = datetime.now(UTC)
        count = queries.purge_quarantine(engine, now - timedelta(days=purge_days), by=user_name(), at=now)
        sys.stdout.write(f"{count} messages forgotten\n")
        return
    records = queries.quarantined(engine, limit)
    print_records(records, lambda: report.quarantine_table(records), is_json=is_json)


@command_line.command(epilog=examples(f"{PROGRAM} seen --json"))
@json_option
@of_database()
def seen(engine: Engine, *, is_json: bool) -> None:
    """Show when each vehicle was last heard from."""
    records = queries.last_seen(engine)
    print_records(records, lambda: report.seen_table(records), is_json=is_json)


@command_line.command(epilog=examples(f"{PROGRAM} codes", f"{PROGRAM} codes --json"))
@json_option
@of_database()
def codes(engine: Engine, *, is_json: bool) -> None:
    """Show the trouble codes that controllers report."""
    records = queries.trouble_codes(engine)
    print_records(records, lambda: report.codes_table(records), is_json=is_json)


@command_line.command(
    epilog=examples(f"{PROGRAM} fill car1 DCTF-II --at 2026-01-31 --odometer-km 61200", f"{PROGRAM} fill car1 --undo")
)
@vehicle_argument
@click.argument("product", metavar="[PRODUCT]", required=False, help="name of the fluid")
@click.option("--at", metavar="DATE", help="ISO 8601, UTC without a zone (default: now)")
@click.option("--odometer-km", metavar="KM", type=float, help="reading of the odometer")
@click.option("--note", help="a note to keep with it")
@click.option(
    "--insist",
    "is_insisted",
    is_flag=True,
    help="note an odometer that does not fit to the results, as after a change of the instrument cluster",
)
@click.option(
    "--undo",
    "is_undone",
    is_flag=True,
    help="take back the last fill, or the one within a day of --at: it was noted by mistake",
)
@of_database()
def fill(
    engine: Engine,
    *,
    vehicle: str,
    product: str | None,
    at: str | None,
    odometer_km: float | None,
    note: str | None,
    is_insisted: bool,
    is_undone: bool,
) -> None:
    """Note that a vehicle got new fluid."""
    queries.check_vehicle(engine, vehicle)
    moment = None if at is None else config.parse_moment(at)
    if is_undone:
        gone = queries.withdraw_fill(engine, vehicle, moment, by=user_name())
        sys.stdout.write(f"{vehicle}: the fill at {gone.isoformat()} is taken back\n")
        return
    if product is None:
        raise BackendConfigError("which fluid? give its name, or --undo to take back the last fill")
    since = queries.note_fill(
        engine,
        vehicle,
        product,
        at=moment or datetime.now(UTC),
        odometer_m=None if odometer_km is None else odometer_km * 1000.0,
        note=note,
        by=user_name(),
        is_insisted=is_insisted,
    )
    sys.stdout.write(f"{vehicle}: {product} since {since.isoformat()}\n")


@command_line.command(epilog=examples(f"{PROGRAM} partitions --ahead 6"))
@json_option
@click.option("--ahead", type=click.IntRange(0, months.MOST_MONTHS), default=3, help="months ahead")
@click.option(
    "--back",
    type=click.IntRange(0, months.MOST_MONTHS),
    default=0,
    help="months back, for old results that may still arrive",
)
@of_database()
def partitions(engine: Engine, *, ahead: int, back: int, is_json: bool) -> None:
    """Make the months in which a PostgreSQL database keeps results, and show all."""
    months.keep_months(engine, datetime.now(UTC), ahead, back)
    records = [asdict(part) for part in months.partitions(engine)]
    print_records(records, lambda: report.partition_table(records), is_json=is_json)


@command_line.command("hash", epilog=examples(f"{PROGRAM} hash"))
@of_database()
def hash_of_results(engine: Engine) -> None:
    """Show a hash of all results: equal results, equal hash, in any database."""
    results = queries.table_hash(engine)
    sys.stdout.write(f"{results.sha256}  {results.row_count} results\n")
