"""What the commands do, once their words are checked; loads the database's libraries, which are an extra."""

import getpass
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from types import MappingProxyType, SimpleNamespace
from typing import Final

from rich.table import Table
from sqlalchemy import Engine

from clutchdiag_io.console import PeopleConsole
from fleet_backend import config, queries, report
from fleet_backend.application import run_ingest
from fleet_backend.arguments import BROKER_VARIABLE
from fleet_backend.choices import TrendAxis
from fleet_backend.database import default_database, open_database, place_of
from fleet_backend.errors import BackendConfigError
from fleet_backend.migrate import make_ready, migrate, newest_revision
from fleet_backend.months import keep_months, partitions
from fleet_link import BrokerAddress

Command = Callable[[SimpleNamespace, Engine], None]


def execute(options: SimpleNamespace, commands: Mapping[str, Command]) -> None:
    """Do what a command line asks for; raises FleetBackendError."""
    for name in ("vehicle", "acknowledge", "product", "note", "by"):
        if not (getattr(options, name, None) or "").isprintable():
            raise BackendConfigError(f"{name} holds characters that are not text")
    must_exist = options.command != "migrate"  # a mistyped name must not become an empty fleet
    engine = open_database(options.database or default_database(), must_exist=must_exist)
    try:
        if options.command not in _READY_BY_THEMSELVES:
            make_ready(engine)
        commands[options.command](options, engine)
    finally:
        engine.dispose()


def _ingest(options: SimpleNamespace, engine: Engine) -> None:
    pace = config.parse_pace(options.batch, options.patience, takes_bundles=not options.no_bundles)
    run_ingest(
        engine,
        _broker_of(options),
        pace,
        options.worker,
        options.alive,
        group=config.parse_group(options.group),
        quotas=config.parse_quotas(options.quotas),
        metrics=metrics_of(options),
    )


def metrics_of(options: SimpleNamespace) -> config.ServerAddress | None:
    return None if options.metrics is None else config.parse_listen(options.metrics, option="--metrics")


def user_name() -> str:
    """Return who runs this, for the audit; a container's user may have no name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid {os.getuid()}"


def _broker_of(options: SimpleNamespace) -> BrokerAddress:
    if not options.broker:
        raise BackendConfigError(f"no broker: give --broker or set {BROKER_VARIABLE}")
    files = {"ca": options.ca, "certificate": options.cert, "key": options.key}
    return config.parse_broker(options.broker, **files, may_be_nats=True)


def _migrate(_options: SimpleNamespace, engine: Engine) -> None:
    migrate(engine)
    sys.stdout.write(f"{place_of(engine)}: schema {newest_revision()}\n")


def _partitions(options: SimpleNamespace, engine: Engine) -> None:
    keep_months(engine, datetime.now(UTC), options.ahead, options.back)
    records = [asdict(one) for one in partitions(engine)]
    tell(options, records, lambda: report.partition_table(records))


def _table(options: SimpleNamespace, engine: Engine) -> None:
    records = queries.worst_first(engine, options.limit)
    tell(options, records, lambda: report.fleet_table(records))


def _trend(options: SimpleNamespace, engine: Engine) -> None:
    queries.check_vehicle(engine, options.vehicle)
    records = queries.trend(engine, options.vehicle, options.clutch, TrendAxis(options.against))
    whose = f"{options.vehicle}, {queries.clutch_name(engine, options.vehicle, options.clutch)}"
    title = f"{whose}: {len(records)} valid shifts against {options.against}"
    tell(options, records, lambda: report.trend_table(title, records))


def _quarantine(options: SimpleNamespace, engine: Engine) -> None:
    if options.purge_days is not None:
        now = datetime.now(UTC)
        count = queries.purge_quarantine(engine, now - timedelta(days=options.purge_days), by=user_name(), at=now)
        sys.stdout.write(f"{count} messages forgotten\n")
        return
    records = queries.quarantined(engine, options.limit)
    tell(options, records, lambda: report.quarantine_table(records))


def _seen(options: SimpleNamespace, engine: Engine) -> None:
    records = queries.last_seen(engine)
    tell(options, records, lambda: report.seen_table(records))


def _codes(options: SimpleNamespace, engine: Engine) -> None:
    records = queries.trouble_codes(engine)
    tell(options, records, lambda: report.codes_table(records))


def _fill(options: SimpleNamespace, engine: Engine) -> None:
    queries.check_vehicle(engine, options.vehicle)
    at = None if options.at is None else config.parse_moment(options.at)
    if options.undo:
        gone = queries.withdraw_fill(engine, options.vehicle, at, by=user_name())
        sys.stdout.write(f"{options.vehicle}: the fill at {gone.isoformat()} is taken back\n")
        return
    if options.product is None:
        raise BackendConfigError("which fluid? give its name, or --undo to take back the last fill")
    odometer_m = None if options.odometer_km is None else options.odometer_km * 1000.0
    since = queries.note_fill(
        engine,
        options.vehicle,
        options.product,
        at=at or datetime.now(UTC),
        odometer_m=odometer_m,
        note=options.note,
        by=user_name(),
        is_insisted=options.insist,
    )
    sys.stdout.write(f"{options.vehicle}: {options.product} since {since.isoformat()}\n")


def _hash(_options: SimpleNamespace, engine: Engine) -> None:
    found = queries.table_hash(engine)
    sys.stdout.write(f"{found.sha256}  {found.row_count} results\n")


def tell(options: SimpleNamespace, records: Sequence[report.Record], sheet: Callable[[], Table]) -> None:
    if options.json:
        report.write_json(records, sys.stdout)
    else:
        PeopleConsole().print(sheet())


_READY_BY_THEMSELVES: Final = frozenset({"ingest", "migrate"})  # the schema is their own affair
COMMANDS: Final[Mapping[str, Command]] = MappingProxyType({
    "ingest": _ingest, "migrate": _migrate, "table": _table, "trend": _trend, "quarantine": _quarantine, "seen": _seen,
    "codes": _codes, "fill": _fill, "hash": _hash, "partitions": _partitions,
})  # fmt: skip
