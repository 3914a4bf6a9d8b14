"""The commands of the fleet office: alarms, peers, the pages, the watch, and what is forgotten."""

import sys
from collections import Counter
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Final

import click
from sqlalchemy import Engine

from clutchdiag_io.command_line import FILE, examples, together
from clutchdiag_io.console import PeopleConsole
from fleet_backend import queries, report
from fleet_backend.alarms import book
from fleet_backend.alarms.rules import Limits
from fleet_backend.commands import (
    PROGRAM,
    address_of,
    json_option,
    metrics_at,
    metrics_option,
    of_database,
    print_records,
    user_name,
    vehicle_argument,
)
from fleet_backend.config import parse_listen
from fleet_backend.database import open_database
from fleet_backend.errors import BackendConfigError, BackendExtraError
from fleet_backend.office.retention import forget_vehicle
from fleet_backend.office.retention import retain as retain_months
from fleet_backend.office_tables import ALARM, COMMAND_LINE
from fleet_backend.page.access import Access, read_access

DEFAULT_LISTEN: Final = "127.0.0.1:8090"
_access_option = click.option(
    "--access", type=FILE, help="who may read and change what, behind a proxy that logs people in (docs/fleet.md)"
)


@click.command(
    epilog=examples(
        f"{PROGRAM} alarms --all --json", f"{PROGRAM} alarms --acknowledge car1 --clutch 2 --note 'fluid is on order'"
    )
)
@json_option
@click.option("--all", "has_cleared", is_flag=True, help="include cleared alarms")
@click.option(
    "--acknowledge",
    metavar="VEHICLE",
    help="acknowledge the open alarms of its --clutch, or without --clutch what was kept aside on its topics",
)
@click.option(
    "--clutch", type=click.Choice([0, 1, 2]), help="whose alarms are acknowledged; 0: those of the vehicle as a whole"
)
@click.option("--by", metavar="WHO", help="who acknowledges (default: the user)")
@click.option("--note", help="a note to keep with it")
@of_database()
def alarms(
    engine: Engine,
    *,
    has_cleared: bool,
    acknowledge: str | None,
    clutch: int | None,
    by: str | None,
    note: str | None,
    is_json: bool,
) -> None:
    """Show or acknowledge alarms that the watch raised."""
    if acknowledge is not None:
        _acknowledge(engine, acknowledge, clutch, by or user_name(), note)
        return
    raised = book.alarms(engine, *(() if has_cleared else (ALARM.c.cleared_at.is_(None),)))
    identities = queries.identity_alarms(engine)
    records = [*raised, *({"rule": "identity", **record} for record in identities)]
    print_records(records, lambda: report.alarm_table(raised, identities), is_json=is_json)


def _acknowledge(engine: Engine, vehicle: str, clutch: int | None, by: str, text: str | None) -> None:
    now = datetime.now(UTC)
    queries.check_vehicle(engine, vehicle)
    if clutch is None:
        count = queries.acknowledge_quarantine(engine, vehicle, by=by, at=now)
        sys.stdout.write(f"{count} messages on the topics of {vehicle} acknowledged\n")
    else:
        note = book.Note(by=by, role=COMMAND_LINE, at=now, text=text)
        whose = f"clutch {clutch} of {vehicle}" if clutch else vehicle
        count = book.acknowledge_open(engine, vehicle, clutch, note)
        if not count:
            raise BackendConfigError(f"{whose} has no alarm that waits for an acknowledgement")
        sys.stdout.write(f"{count} alarms of {whose} acknowledged\n")


@click.command(epilog=examples(f"{PROGRAM} peers", f"{PROGRAM} peers --keep --write peers.json"))
@json_option
@click.option("--keep", is_flag=True, help="keep what was learned as the next version: prognoses begin with it")
@click.option("--write", type=FILE, help="write what was learned as JSON, for diag-service history --peers")
@of_database()
def peers(engine: Engine, *, keep: bool, write: Path | None, is_json: bool) -> None:
    """Learn how fluids of each type usually age."""
    with _of_the_page():
        from fleet_backend.ageing.peers import fleet_ageing, keep_population, write_population
    learned = fleet_ageing(engine)
    version = None
    if keep:
        version = keep_population(
            engine, learned.population, learned.clutch_count, at=datetime.now(UTC), by=user_name()
        )
    if write is not None:
        write_population(write, learned.population, version)
    if is_json:
        kept_as = [] if version is None else [{"record": "population", "version": version}]
        report.write_json([*learned.usual, *kept_as], sys.stdout)
        return
    PeopleConsole().print(report.usual_table(learned.usual, learned.clutch_count, learned.left_out_count))
    if version is not None:
        sys.stdout.write(f"kept as population {version}\n")


@click.command(epilog=examples(f"{PROGRAM} serve", f"{PROGRAM} serve --listen 127.0.0.1:8090"))
@click.option(
    "--listen",
    metavar="ADDRESS",
    default=DEFAULT_LISTEN,
    help="HOST:PORT to listen at, a loopback address unless --access is given; port 0 takes any free one",
)
@together(_access_option, metrics_option)
@of_database()
def serve(engine: Engine, *, listen: str, access: Path | None, metrics: str | None) -> None:
    """Show the fleet to browsers and programs, until stopped."""
    place = metrics_at(metrics)
    with _of_the_page():
        from fleet_backend.page import server
    _serve(engine, listen, access, partial(server.show, place))


def _serve(
    engine: Engine, listen: str, access: Path | None, beside: Callable[[Any], Coroutine[None, None, None]]
) -> None:
    """Serve the pages while something else is done beside."""
    place = parse_listen(listen, has_login=access is not None)
    with _of_the_page():
        from fleet_backend.page import server
    permitted = read_access(access) if access is not None else Access()
    readers = open_database(address_of(), must_exist=True, is_read_only=True)
    try:
        server.run_server(readers, engine, place.host, place.port, permitted, beside)
    finally:
        readers.dispose()


@click.command(
    epilog=examples(
        f"{PROGRAM} watch --notify workshop.url", f"{PROGRAM} watch --notify workshop.url --notify hook.url --once"
    )
)
@click.option(
    "--notify",
    type=FILE,
    multiple=True,
    help="tell each alarm at the address in this file, as apprise has it: mail, chat, webhook, MQTT; may be repeated",
)
@click.option(
    "--service-km", metavar="KM", type=click.IntRange(1, 300_000), default=15_000, help="distance to the next service"
)
@click.option(
    "--silence-days",
    metavar="D",
    type=click.IntRange(2, 3650),
    default=14,
    help="days without a result until an alarm is raised",
)
@click.option(
    "--listen", metavar="ADDRESS", help="show the pages of serve there, too: both share one view of the fleet"
)
@together(_access_option, metrics_option)
@click.option("--once", is_flag=True, help="judge each vehicle once, however long that takes, deliver, and end")
@of_database()
def watch(
    engine: Engine,
    *,
    notify: Sequence[Path],
    service_km: int,
    silence_days: int,
    listen: str | None,
    access: Path | None,
    metrics: str | None,
    once: bool,
) -> None:
    """Raise alarms by rules and deliver them, until stopped."""
    limits = Limits(silence_from=timedelta(days=silence_days))
    with _of_the_page():
        from fleet_backend.office import watching
        from fleet_backend.office.watching import read_carrier
    carriers = [read_carrier(path) for path in notify]
    for name, count in Counter(carrier.name for carrier in carriers).items():
        if count > 1:
            raise BackendConfigError(
                f"--notify: two files are called {name}, by which alarms remember whom they reached"
            )
    orders = watching.Orders(carriers=carriers, limits=limits, service_distance_m=1000.0 * service_km)
    if listen is not None:
        if once:
            raise BackendConfigError("--once ends, --listen does not: give one of them")

        def beside(keeper: Any) -> Coroutine[None, None, None]:  # noqa: ANN401 - of the page, an extra
            return watching.watch_for_ever(engine, orders, metrics_at(metrics), keeper)

        _serve(engine, listen, access, beside)
        return
    watching.run_watch(engine, orders, metrics_at(metrics), is_once=once)


@contextmanager
def _of_the_page() -> Iterator[None]:
    """Raise ExtraMissingError where something that is imported meanwhile needs the extra of the page."""
    try:
        yield
    except ModuleNotFoundError as exc:
        if exc.name is None or exc.name.startswith("fleet_backend"):
            raise
        raise BackendExtraError(exc.name, extra="page") from exc


@click.command(epilog=examples(f"{PROGRAM} retain --months 24"))
@click.option("--months", type=click.IntRange(1, 1200), required=True, help="whole months to keep besides this one")
@of_database()
def retain(engine: Engine, months: int) -> None:
    """Forget old results; the last of each clutch stays."""
    done = retain_months(engine, months, now=datetime.now(UTC), by=user_name())
    rest = f"; {done.kept_count} earlier ones stay, as they are the last of their clutches" if done.kept_count else ""
    sys.stdout.write(f"{done.gone_count} results from before {done.before:%Y-%m} forgotten{rest}\n")


@click.command(epilog=examples(f"{PROGRAM} forget car2", f"{PROGRAM} forget car2 --json"))
@vehicle_argument
@json_option
@of_database()
def forget(engine: Engine, *, vehicle: str, is_json: bool) -> None:
    """Delete all that is stored of a vehicle, and prove it by a second look."""
    done = forget_vehicle(engine, vehicle, now=datetime.now(UTC), by=user_name())
    if is_json:
        record = {"schema": "clutchdiag/fleet-forgotten/v1", "vehicle_sha256": done.digest}
        report.write_json([{**record, "gone": done.gone, "left": done.left}], sys.stdout)
        return
    sys.stdout.writelines(f"{name}: {count} rows\n" for name, count in done.gone.items() if count)
    sys.stdout.write(
        f"{vehicle} is forgotten: {sum(done.gone.values())} rows; a second look found none left. What it still "
        "sends is stored anew; retained messages are the broker's\n"
    )
