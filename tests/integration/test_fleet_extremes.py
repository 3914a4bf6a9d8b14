"""Numbers at the bounds of what can be and far beyond, from a vehicle or in an old database, cost nobody else."""

import math
from datetime import UTC, datetime
from functools import cache
from typing import Any

import pytest
from sqlalchemy import Engine

from fleet_backend.intake import INGESTED, MessageKind, Received, batch_of, receive_all
from fleet_backend.office.retention import retain
from fleet_backend.office.watching import Orders, Watch
from fleet_backend.writer import Writer
from fleet_contract import Channel, Outcome
from tests.support.extremes import Schema, message, put, values
from tests.support.fleet import delivered, fleet_result, message_of
from tests.support.fleet_page import asked, sources_of

NOW = datetime(2026, 6, 15, 12, tzinfo=UTC)
SCHEMAS = [Schema(channel) for channel in INGESTED if channel is not Channel.BUNDLE]
PAGES = ("/", "/maintenance", "/alarms")
OFFICE = ("/api/v1/vehicles", "/api/v1/maintenance", "/api/v1/alarms")


@cache
def extremes(described: Schema) -> list[tuple[Received, bool]]:
    """Return what becomes of messages, one number of each at its bounds or beyond, and whether it may be."""
    found = []
    for place, part in described.numbers.items():
        least, most = part.get("minimum", 0), part.get("maximum", 1)
        for value in values(part):
            more: dict[str, Any] = {"vehicle": f"car-{place[0]}"}
            if described.channel is Channel.SHIFT:
                more["stream"] = f"{'.'.join(map(str, place))}={value!r}"
            told = message(described.channel, put(described.record | more, place, value))
            (taken,) = receive_all(delivered(told), NOW)
            is_possible = least <= value <= most and value > part.get("exclusiveMinimum", -math.inf)
            found.append((taken, is_possible))
    return found


def all_goes_on(engine: Engine) -> None:
    """Watch, show everything and forget what is old."""
    Watch(engine, Orders(), lambda: NOW).round(judging_s=float("inf"))
    sources = sources_of(engine, now=NOW)
    sources.keeper.work_ahead(float("inf"))
    names = sources.keeper.snapshot.vehicles
    paths = (*PAGES, *OFFICE, *(f"{root}/{name}" for name in names for root in ("/vehicles", "/api/v1/vehicles")))
    answers = zip(paths, asked(sources, *paths), strict=True)
    assert {path: answer.status_code for path, answer in answers if answer.status_code != 200} == {}
    retain(engine, 1, now=NOW, by="ann")


@pytest.mark.parametrize("described", SCHEMAS, ids=lambda one: one.channel.label)
def test_every_number_has_bounds_that_a_sum_of_them_keeps(described: Schema) -> None:
    for place, part in described.numbers.items():
        bounds: Any = part.get("exclusiveMinimum", part.get("minimum")), part.get("maximum")
        assert None not in bounds, place
        assert max(map(abs, bounds)) <= 1e19, place
        if isinstance(place[-1], str) and place[-1] != "a_1" and place[-1] != "seq":  # that is one of many
            assert max(map(abs, bounds)) < 1e19, place


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_number_at_its_bounds_is_stored_and_one_beyond_is_put_aside(engine: Engine) -> None:
    for described in SCHEMAS:
        judged = extremes(described)
        for taken, is_possible in judged:
            assert (taken.kind is not MessageKind.POISON) is is_possible, taken.message.payload
            if taken.kind is MessageKind.POISON:
                assert taken.row["reason"] in {"schema", "malformed"}
                assert taken.receipt is None or taken.receipt.outcome is Outcome.QUARANTINED
        Writer(engine).store(batch_of([one for one, _ in judged]))
    all_goes_on(engine)


@pytest.mark.parametrize(("year", "is_stored"), [(1, False), (1899, False), (1900, True), (2199, True), (9999, False)])
def test_a_moment_of_no_vehicle_is_put_aside(engine: Engine, year: int, is_stored: bool) -> None:
    """Where it was stored, the month after it had to exist too."""
    result = fleet_result(produced_at=f"{year:04}-12-31T23:59:59.999999Z")
    (taken,) = receive_all(message_of(result), NOW)
    assert (taken.kind is MessageKind.SHIFT) is is_stored
    Writer(engine).store(batch_of([taken]))
    all_goes_on(engine)
