"""What the commands of the fleet office do."""

import sys
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from types import SimpleNamespace
from typing import Any, Final

from sqlalchemy import Engine

from clutchdiag_io.console import PeopleConsole
from fleet_backend import queries, report
from fleet_backend.alarms import book
from fleet_backend.alarms.rules import Limits, parse_service_km, parse_silence
from fleet_backend.commands import Command, metrics_of, tell, user_name
from fleet_backend.config import parse_listen
from fleet_backend.database import default_database, open_database
from fleet_backend.errors import BackendConfigError, BackendExtraError
from fleet_backend.office.retention import forget_vehicle
from fleet_backend.office.retention import retain as retain_months
from fleet_backend.office_tables import ALARM, COMMAND_LINE
from fleet_backend.page.access import Access, read_access


def alarms(options: SimpleNamespace, engine: Engine) -> None:
    if options.acknowledge is not None:
        _acknowledge(options, engine)
        return
    raised = book.alarms(engine, *(() if options.all else (ALARM.c.cleared_at.is_(None),)))
    identities = queries.identity_alarms(engine)
    records = [*raised, *({"rule": "identity", **record} for record in identities)]
    tell(options, records, lambda: report.alarm_table(raised, identities))


def _acknowledge(options: SimpleNamespace, engine: Engine) -> None:
    vehicle, clutch = options.acknowledge, options.clutch
    by, now = options.by or user_name(), datetime.now(UTC)
    queries.check_vehicle(engine, vehicle)
    if clutch is None:
        count = queries.acknowledge_quarantine(engine, vehicle, by=by, at=now)
        sys.stdout.write(f"{count} messages on the topics of {vehicle} acknowledged\n")
    else:
        note = book.Note(by=by, role=COMMAND_LINE, at=now, text=options.note)
        whose = f"clutch {clutch} of {vehicle}" if clutch else vehicle
        count = book.acknowledge_open(engine, vehicle, clutch, note)
        if not count:
            raise BackendConfigError(f"{whose} has no alarm that waits for an acknowledgement")
        sys.stdout.write(f"{count} alarms of {whose} acknowledged\n")


def peers(options: SimpleNamespace, engine: Engine) -> None:
    with _of_the_page():
        from fleet_backend.page import populations
        from fleet_backend.page.peers import fleet_ageing
    found = fleet_ageing(engine)
    version = None
    if options.keep:
        version = populations.keep(engine, found.population, found.clutch_count, at=datetime.now(UTC), by=user_name())
    if options.write is not None:
        populations.write(options.write, found.population, version)
    if options.json:
        kept_as = [] if version is None else [{"record": "population", "version": version}]
        report.write_json([*found.usual, *kept_as], sys.stdout)
        return
    PeopleConsole().print(report.usual_table(found.usual, found.clutch_count, found.left_out_count))
    if version is not None:
        sys.stdout.write(f"kept as population {version}\n")


def serve(
    options: SimpleNamespace, engine: Engine, beside: Callable[[Any], Coroutine[None, None, None]] | None = None
) -> None:
    metrics = metrics_of(options)
    place = parse_listen(options.listen, has_login=options.access is not None)
    with _of_the_page():
        from fleet_backend.page import server
    access = read_access(options.access) if options.access is not None else Access()
    readers = open_database(options.database or default_database(), must_exist=True, is_read_only=True)
    try:
        server.run_server(readers, engine, place.host, place.port, access, beside or partial(server.show, metrics))
    finally:
        readers.dispose()


def watch(options: SimpleNamespace, engine: Engine) -> None:
    limits = Limits(silence_from=parse_silence(options.silence_days))
    distance_m = parse_service_km(options.service_km)
    with _of_the_page():
        from fleet_backend.office import watching
        from fleet_backend.office.watching import read_carrier
    carriers = [read_carrier(path) for path in options.notify]
    for name, count in Counter(one.name for one in carriers).items():
        if count > 1:
            raise BackendConfigError(
                f"--notify: two files are called {name}, by which alarms remember whom they reached"
            )
    orders = watching.Orders(carriers=carriers, limits=limits, service_distance_m=distance_m)
    if options.listen is not None:
        if options.once:
            raise BackendConfigError("--once ends, --listen does not: give one of them")
        serve(options, engine, lambda keeper: watching.watch_for_ever(engine, orders, metrics_of(options), keeper))
        return
    watching.run_watch(engine, orders, metrics_of(options), is_once=options.once)


@contextmanager
def _of_the_page() -> Iterator[None]:
    """Raise ExtraMissingError where something that is imported meanwhile needs the extra of the page."""
    try:
        yield
    except ModuleNotFoundError as exc:
        if exc.name is None or exc.name.startswith("fleet_backend"):
            raise
        raise BackendExtraError(exc.name, extra="page") from exc


def retain(options: SimpleNamespace, engine: Engine) -> None:
    done = retain_months(engine, options.months, now=datetime.now(UTC), by=user_name())
    kept = f"; {done.kept_count} earlier ones stay, as they are the last of their clutches" if done.kept_count else ""
    sys.stdout.write(f"{done.gone_count} results from before {done.before:%Y-%m} forgotten{kept}\n")


def forget(options: SimpleNamespace, engine: Engine) -> None:
    done = forget_vehicle(engine, options.vehicle, now=datetime.now(UTC), by=user_name())
    if options.json:
        record = {"schema": "clutchdiag/fleet-forgotten/v1", "vehicle_sha256": done.digest}
        report.write_json([{**record, "gone": done.gone, "left": done.left}], sys.stdout)
        return
    sys.stdout.writelines(f"{name}: {count} rows\n" for name, count in done.gone.items() if count)
    sys.stdout.write(
        f"{options.vehicle} is forgotten: {sum(done.gone.values())} rows; a second look found none left. What it still "
        "sends is stored anew; retained messages are the broker's\n"
    )


COMMANDS: Final[Mapping[str, Command]] = {
    "alarms": alarms, "forget": forget, "peers": peers, "retain": retain, "serve": serve, "watch": watch,
}  # fmt: skip
