"""A vehicle is forgotten: nothing about it is left in any table, all about others stays."""

from collections.abc import Iterator

import pytest
from sqlalchemy import Engine, inspect, text

from fleet_backend import queries
from fleet_backend.alarms import book
from fleet_backend.database import transaction
from fleet_backend.errors import UnknownVehicleError
from fleet_backend.office.retention import forget_vehicle
from fleet_backend.office_tables import AUDIT
from fleet_backend.rows import quarantine_row
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import NOW
from tests.support.fleet_page import fill_database, raise_alarms

VEHICLE = "worn"


def cells(engine: Engine) -> Iterator[str]:
    """Yield all that is stored, cell by cell."""
    with transaction(engine) as connection:
        for name in inspect(connection).get_table_names():
            for row in connection.execute(text(f'SELECT * FROM "{name}"')):  # noqa: S608 - our own tables
                yield from map(str, row)


@pytest.fixture(name="filled")
def _filled(engine: Engine) -> Engine:
    fill_database(engine)
    raise_alarms(engine)
    row: dict[str, object] = {"vehicle": VEHICLE, "calibration_version": "1", "content": "{}"}
    Writer(engine).store(
        Batch(
            quarantined=[
                quarantine_row(
                    NOW,
                    topic=f"clutchdiag/v1/{VEHICLE}/shift",
                    vehicle=VEHICLE,
                    payload=b"{}",
                    reason="schema",
                    detail="of no kind",
                )
            ],
            calibrations=[row],
        )
    )
    book.acknowledge_open(engine, VEHICLE, 2, book.Note(by="ann", role="workshop", at=NOW, text=None))
    return engine


def test_nothing_is_left_of_a_vehicle_and_all_of_the_others(filled: Engine) -> None:
    others = queries.result_count(filled)
    assert any(VEHICLE in cell for cell in cells(filled))
    done = forget_vehicle(filled, VEHICLE, now=NOW, by="ann")
    assert set(done.left.values()) == {0}
    assert all(done.gone[name] for name in ("shift_result", "calibration", "quarantine", "alarm", "audit"))
    assert [cell for cell in cells(filled) if VEHICLE in cell] == []
    assert queries.result_count(filled) == others - done.gone["shift_result"] > 0
    with transaction(filled) as connection:
        subjects = [str(row.subject) for row in connection.execute(AUDIT.select())]
    assert f"vehicle with sha256 {done.digest}" in subjects
    with pytest.raises(UnknownVehicleError):
        forget_vehicle(filled, VEHICLE, now=NOW, by="ann")
