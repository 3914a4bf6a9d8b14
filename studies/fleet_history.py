"""A fleet with a past, made inside PostgreSQL from one result with other numbers; nothing of it is measured."""

from datetime import UTC, datetime, timedelta
from math import ceil
from typing import Final

from sqlalchemy import Engine, text

from fleet_backend.database import transaction
from fleet_backend.months import months_between, months_on
from tests.support.fleet import fleet_result, row_of

PER_DAY: Final = 150  # results of one clutch of a vehicle that is driven
_NEW: Final = {
    "vehicle": "'h' || v",
    "seq": "2 * round(extract(epoch FROM t - CAST(:origin AS timestamptz)) / CAST(:step_s AS numeric))::bigint + c",
    "clutch": "c",
    "number": "1",
    "produced_at": "t",
    "start_at": "t - interval '2 seconds'",
    "end_at": "t",
    "stored_at": "t",
    "odometer_m": "extract(epoch FROM t - CAST(:first AS timestamptz)) * 0.5",
    "mu_c": "0.13 + 0.002 * random()",
    "running_mu_c": "0.13",
    "content_digest": "(random() * 1e15)::bigint",
    "condition": "CASE WHEN v % 20 = 0 AND t > CAST(:last AS timestamptz) - interval '1 day' THEN 'change_fluid'"
    " ELSE 'good' END",
}


def make_fleet(engine: Engine, vehicle_count: int) -> None:
    """Make vehicles ``h1`` and so on, with two clutches each."""
    with transaction(engine) as connection:
        made = {"count": vehicle_count}
        connection.execute(
            text("INSERT INTO vehicle (vehicle) SELECT 'h' || v FROM generate_series(1, :count) AS v"), made
        )
        connection.execute(
            text(
                "INSERT INTO clutch (vehicle, clutch) "
                "SELECT 'h' || v, c FROM generate_series(1, :count) v, generate_series(1, 2) c"
            ),
            made,
        )


def make_results(
    engine: Engine,
    vehicle_count: int,
    first: datetime,
    last: datetime,
    per_day: float = PER_DAY,
    *,
    origin: datetime | None = None,
) -> int:
    """Make results of all clutches from one moment to another, month by month; return how many.

    Positions count from ``origin`` (default: ``first``), so that a fleet without a past can have those of one with it.
    """
    sample = row_of(fleet_result())
    names = list(sample)
    columns = ", ".join(names)
    values = ", ".join(_NEW.get(name, f":s_{name}") for name in names)
    fixed = {f"s_{name}": value for name, value in sample.items() if name not in _NEW}
    statement = text(
        f"INSERT INTO shift_result ({columns}, stored_at) SELECT {values}, t"  # noqa: S608 - our own names
        " FROM generate_series(CAST(:begin AS timestamptz), CAST(:end AS timestamptz), CAST(:step AS interval)) AS t,"
        " generate_series(1, :count) AS v, generate_series(1, 2) AS c"
    )
    made, step_s = 0, 86400.0 / per_day
    origin = first if origin is None else origin
    start = first.date().replace(day=1)
    for month in months_between(start, months_on(last.date().replace(day=1), 1)):
        begin = datetime(month.year, month.month, 1, tzinfo=UTC)
        begin = first + timedelta(seconds=step_s * max(0, ceil((begin - first).total_seconds() / step_s)))
        following = months_on(month, 1)
        end = min(last, datetime(following.year, following.month, 1, tzinfo=UTC)) - timedelta(milliseconds=1)
        span = {
            "begin": begin,
            "end": end,
            "step": f"{step_s} seconds",
            "first": first,
            "origin": origin,
            "last": last,
            "step_s": step_s,
        }
        with transaction(engine) as connection:
            connection.exec_driver_sql("SET LOCAL synchronous_commit = off")
            made += connection.execute(statement, {**fixed, **span, "count": vehicle_count}).rowcount
    return made


def settle(engine: Engine) -> None:
    """Let PostgreSQL count what it has, as it does by itself sooner or later."""
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.exec_driver_sql("VACUUM ANALYZE shift_result")
        connection.exec_driver_sql("CHECKPOINT")
