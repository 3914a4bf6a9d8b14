"""What the commands do, once their words are checked; loads the database's libraries, which are an extra."""

import getpass
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from importlib import import_module
from types import MappingProxyType, ModuleType, SimpleNamespace
from typing import Final

from sqlalchemy import Engine

from fleet_backend import lots, queries, report
from fleet_backend.alarms.carriers import Carrier, Mail, Webhook
from fleet_backend.alarms.mqtt import Mqtt
from fleet_backend.alarms.rules import Limits
from fleet_backend.alarms.words import parse_mail, parse_secret, parse_service_km, parse_silence, parse_webhook
from fleet_backend.application import run_ingest
from fleet_backend.arguments import BROKER_VARIABLE
from fleet_backend.choices import Axis
from fleet_backend.config import parse_broker, parse_group, parse_listen, parse_moment, parse_pace
from fleet_backend.database import default_database, open_database, place_of
from fleet_backend.errors import ConfigError, ExtraMissingError
from fleet_backend.layout import Sheet
from fleet_backend.migrate import make_ready, migrate, newest_revision
from fleet_backend.months.partitions import keep_months, partitions
from fleet_backend.months.retention import retain, roll_up
from fleet_backend.page.access import Access, read_access
from fleet_link import BrokerAddress

Command = Callable[[SimpleNamespace, Engine], None]


def execute(options: SimpleNamespace) -> None:
    """Do what a command line asks for; raises FleetBackendError."""
    for name in ("vehicle", "acknowledge", "product", "note", "by"):
        if not (getattr(options, name, None) or "").isprintable():
            raise ConfigError(f"{name} holds characters that are not text")
    must_exist = options.command != "migrate"  # a mistyped name must not become an empty fleet
    engine = open_database(options.database or default_database(), must_exist=must_exist)
    try:
        _COMMANDS[options.command](options, engine)
    finally:
        engine.dispose()


def _ingest(options: SimpleNamespace, engine: Engine) -> None:
    pace = parse_pace(options.batch, options.patience, takes_bundles=not options.no_bundles)
    run_ingest(
        engine,
        _broker(options, may_be_nats=True),
        pace,
        options.worker,
        options.alive,
        group=parse_group(options.group),
    )


def _user() -> str:
    """Return who runs this, for the audit; a container's user may have no name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid {os.getuid()}"


def _broker(options: SimpleNamespace, *, may_be_nats: bool = False) -> BrokerAddress:
    if not options.broker:
        raise ConfigError(f"no broker: give --broker or set {BROKER_VARIABLE}")
    files = {"ca": options.ca, "certificate": options.cert, "key": options.key}
    return parse_broker(options.broker, **files, may_be_nats=may_be_nats)


def _migrate(_options: SimpleNamespace, engine: Engine) -> None:
    migrate(engine, tell=_tell_of_move)
    sys.stdout.write(f"{place_of(engine)}: schema {newest_revision()}\n")


def _tell_of_move(moved_count: int) -> None:
    sys.stderr.write(f"{moved_count} results moved into months\n")


def _partitions(options: SimpleNamespace, engine: Engine) -> None:
    keep_months(engine, datetime.now(UTC), options.ahead, options.back)
    records = [asdict(one) for one in partitions(engine)]
    _tell(options, records, lambda: report.partition_table(records))


def _rollup(_options: SimpleNamespace, engine: Engine) -> None:
    count = roll_up(engine, datetime.now(UTC))
    sys.stdout.write(f"{count} months of clutches summed up\n")


def _retain(options: SimpleNamespace, engine: Engine) -> None:
    done = retain(engine, options.months, now=datetime.now(UTC), by=_user())
    kept = f"; {done.kept_count} earlier ones stay, as they are the last of their clutches" if done.kept_count else ""
    sys.stdout.write(f"{done.gone_count} results from before {done.before:%Y-%m} forgotten{kept}\n")


def _table(options: SimpleNamespace, engine: Engine) -> None:
    records = queries.worst_first(engine, options.limit)
    _tell(options, records, lambda: report.fleet_table(records))


def _trend(options: SimpleNamespace, engine: Engine) -> None:
    queries.check_vehicle(engine, options.vehicle)
    records = queries.trend(engine, options.vehicle, options.clutch, Axis(options.against))
    title = f"{options.vehicle}, clutch {options.clutch}: {len(records)} valid shifts against {options.against}"
    _tell(options, records, lambda: report.trend_table(title, records))


def _alarms(options: SimpleNamespace, engine: Engine) -> None:
    if options.acknowledge is not None:
        _acknowledge(options, engine)
        return
    clutches = queries.clutch_alarms(engine, is_open_only=not options.all)
    identities = queries.identity_alarms(engine)
    records = [{"alarm": "clutch", **record} for record in clutches]
    records += [{"alarm": "identity", **record} for record in identities]
    _tell(options, records, lambda: report.alarm_table(clutches, identities))


def _acknowledge(options: SimpleNamespace, engine: Engine) -> None:
    vehicle, clutch = options.acknowledge, options.clutch
    by, now = options.by or _user(), datetime.now(UTC)
    queries.check_vehicle(engine, vehicle)
    if clutch is None:
        count = queries.acknowledge_quarantine(engine, vehicle, by=by, at=now)
        sys.stdout.write(f"{count} messages on the topics of {vehicle} acknowledged\n")
    else:
        queries.acknowledge_clutch(engine, vehicle, clutch, by=by, note=options.note, at=now)
        sys.stdout.write(f"alarm of clutch {clutch} of {vehicle} acknowledged\n")


def _quarantine(options: SimpleNamespace, engine: Engine) -> None:
    if options.purge_days is not None:
        now = datetime.now(UTC)
        count = queries.purge_quarantine(engine, now - timedelta(days=options.purge_days), by=_user(), at=now)
        sys.stdout.write(f"{count} messages forgotten\n")
        return
    records = queries.quarantined(engine, options.limit)
    _tell(options, records, lambda: report.quarantine_table(records))


def _seen(options: SimpleNamespace, engine: Engine) -> None:
    records = queries.last_seen(engine)
    _tell(options, records, lambda: report.seen_table(records))


def _codes(options: SimpleNamespace, engine: Engine) -> None:
    records = queries.trouble_codes(engine)
    _tell(options, records, lambda: report.codes_table(records))


def _peers(options: SimpleNamespace, engine: Engine) -> None:
    found = _page_part("fleet_backend.page.peers").fleet_ageing(engine)
    version = None
    if options.keep:
        kept = _page_part("fleet_backend.page.populations")
        version = kept.keep(engine, found.population, found.clutch_count, at=datetime.now(UTC), by=_user())
    if options.write is not None:
        _page_part("fleet_backend.page.populations").write(options.write, found.population, version)
    if options.json:
        kept_as = [] if version is None else [{"record": "population", "version": version}]
        report.write_json([*found.usual, *found.lots, *kept_as], sys.stdout)
        return
    report.show(report.usual_table(found.usual, found.clutch_count, found.left_out_count), sys.stdout, options.width)
    if found.lots:
        report.show(report.lot_standings_table(found.lots), sys.stdout, options.width)
    if version is not None:
        sys.stdout.write(f"kept as population {version}\n")


def _lots(options: SimpleNamespace, engine: Engine) -> None:
    if options.read is not None:
        done = lots.store_lots(engine, lots.read_lots(options.read), at=datetime.now(UTC), by=_user())
        unheard = f"; of {done.unheard_count} of them have not been heard from" if done.unheard_count else ""
        sys.stdout.write(f"{done.lot_count} properties of {done.vehicle_count} vehicles{unheard}\n")
        return
    known = lots.lots_of(engine)
    records = [{"vehicle": one, "name": name, "value": value} for one, own in known.items() for name, value in own]
    _tell(options, records, lambda: report.lots_table(records))


def _fill(options: SimpleNamespace, engine: Engine) -> None:
    queries.check_vehicle(engine, options.vehicle)
    at = None if options.at is None else parse_moment(options.at)
    if options.undo:
        gone = queries.withdraw_fill(engine, options.vehicle, at, by=_user())
        sys.stdout.write(f"{options.vehicle}: the fill at {gone.isoformat()} is taken back\n")
        return
    if options.product is None:
        raise ConfigError("which fluid? give its name, or --undo to take back the last fill")
    odometer_m = None if options.odometer_km is None else options.odometer_km * 1000.0
    since = queries.note_fill(
        engine,
        options.vehicle,
        options.product,
        at=at or datetime.now(UTC),
        odometer_m=odometer_m,
        note=options.note,
        by=_user(),
        is_insisted=options.insist,
    )
    sys.stdout.write(f"{options.vehicle}: {options.product} since {since.isoformat()}\n")


def _serve(options: SimpleNamespace, engine: Engine) -> None:
    place = parse_listen(options.listen, has_login=options.access is not None)
    server = _page_part("fleet_backend.page.server")
    access = read_access(options.access) if options.access is not None else Access()
    readers = open_database(options.database or default_database(), must_exist=True, is_read_only=True)
    try:
        server.run_server(readers, engine, place.host, place.port, access)
    finally:
        readers.dispose()


def _watch(options: SimpleNamespace, engine: Engine) -> None:
    limits = Limits(silence_from=parse_silence(options.silence_days))
    distance_m = parse_service_km(options.service_km)
    carriers: list[Carrier] = []
    if options.webhook is not None:
        carriers.append(Webhook(url=parse_webhook(options.webhook), secret=parse_secret(options.secret)))
    if options.mail:
        server, sender, recipients = parse_mail(options.mail, getattr(options, "from"), options.to)
        carriers.append(Mail(server=server, sender=sender, recipients=recipients))
    if options.mqtt:
        carriers.append(Mqtt(broker=_broker(options)))
    watching = _page_part("fleet_backend.watching")
    orders = watching.Orders(carriers=carriers, limits=limits, service_distance_m=distance_m)
    watching.run_watch(engine, orders, is_once=options.once)


def _page_part(name: str) -> ModuleType:
    """Return a module of the page, which needs another extra; raises ExtraMissingError."""
    try:
        return import_module(name)
    except ModuleNotFoundError as exc:
        if exc.name is None or exc.name.startswith("fleet_backend"):
            raise
        raise ExtraMissingError(exc.name, extra="page") from exc


def _hash(_options: SimpleNamespace, engine: Engine) -> None:
    found = queries.table_hash(engine)
    sys.stdout.write(f"{found.sha256}  {found.row_count} results\n")


def _checked(command: Command) -> Command:
    """Return a command that first makes sure of the schema."""

    def run(options: SimpleNamespace, engine: Engine) -> None:
        make_ready(engine)
        command(options, engine)

    return run


def _tell(options: SimpleNamespace, records: Sequence[report.Record], sheet: Callable[[], Sheet]) -> None:
    if options.json:
        report.write_json(records, sys.stdout)
    else:
        report.show(sheet(), sys.stdout, options.width)


_COMMANDS: Final[Mapping[str, Command]] = MappingProxyType({
    "ingest": _ingest, "migrate": _migrate, "table": _checked(_table), "trend": _checked(_trend),
    "alarms": _checked(_alarms), "quarantine": _checked(_quarantine), "seen": _checked(_seen),
    "codes": _checked(_codes), "peers": _checked(_peers), "lots": _checked(_lots),
    "fill": _checked(_fill), "hash": _checked(_hash), "serve": _checked(_serve),
    "watch": _checked(_watch), "partitions": _checked(_partitions), "rollup": _checked(_rollup),
    "retain": _checked(_retain),
})  # fmt: skip
