"""A fleet, a lake and a store, played by programs whose every record has one more field: see `wider_records`."""

from collections.abc import Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from clutch_results.event_kinds import PackHeat, ShiftParts, ShiftQuality
from clutch_results.records import FluidFill, ShiftResult, fill_record, shift_record
from diag_service.lake.parts import Manifest, Place
from diag_service.store import ResultStore, kept_event
from diag_service.store.reading import StoreReader
from fleet_backend.ageing.prognosis import foretold_now, read_past
from fleet_backend.ageing.results import fills_of, shift_of
from fleet_backend.database import open_database
from fleet_backend.intake import batch_of, receive_all
from fleet_backend.writer import Writer
from fleet_contract import Receipt, fluid_message, key_of
from tests.support.fleet import NOW, delivered, message_of
from tests.support.fleet_page import asked, fill_database, raise_alarms, sources_of, told
from tests.support.histories import STATE, VERSIONS, history
from tests.support.wider_records import FIELD


def play(database: str, lake: str, store: str) -> dict[str, Any]:
    """Play all three; return what their readers say.

    Parameters
    ----------
    database :
        The address of a database with the present schema.
    lake, store :
        Where an earlier program has written them.
    """
    return {**_store(Path(store)), **_lake(lake), **_fleet(database)}


def _fleet(database: str) -> dict[str, Any]:
    """Store what comes in messages; return what pages, tables, alarms and prognoses say of it."""
    engine = open_database(database)
    fill_database(engine)
    fill = FluidFill(vehicle="car2", filled_at="2026-01-01T00:00:00.000000Z", product="a fluid")
    fluid = fluid_message("car2", "2026-01-02T00:00:00.000000Z", [fill_record(fill)], is_to_vehicle=False)
    messages = [*(message_of(_scored(result)) for result in history(60, vehicle="car2")), delivered(fluid)]
    received = [item for message in messages for item in receive_all(message, NOW)]
    Writer(engine).store(batch_of(received))
    raise_alarms(engine)
    sources = sources_of(engine)
    sources.keeper.work_ahead(float("inf"))
    clutches = sources.keeper.snapshot.vehicles["car2"]
    fills = fills_of(engine, "car2")
    pasts = [read_past(engine, now, fills, 1.5e7, None) for now in clutches]
    (table,) = asked(sources, "/vehicles.csv")
    pages = asked(sources, "/", "/vehicles/car2", "/maintenance", "/alarms")
    estimates = [past.estimates[-1] for past in pasts]
    return {
        "came in as": sorted({item.kind.name for item in received}),
        "clutches now": _later(clutches),
        "estimates": _later(estimates),
        "conditions": _later(estimate.conditions for estimate in estimates),
        "qualities": _later(estimate.shift_quality for estimate in estimates),
        "fits": _later(estimate.fit for estimate in estimates),
        "fleet fills": _later(fills),
        "foretold": [past.prognosis is not None for past in pasts],
        "due clutches": [row["clutch"] for row in foretold_now(engine, clutches, None)],
        "pages": [page.status_code for page in pages],
        "columns of the table": table.text.splitlines()[0].split(",").count(FIELD),
        "has alarms": bool(told(sources, "/alarms")["alarms"]),
        "has shift": shift_of(engine, "car2", "stream-1", 1) is not None,
    }


def _scored(result: ShiftResult) -> ShiftResult:
    """Return a result that also tells how well its event went."""
    packs = (PackHeat(), PackHeat(slip_energy_j=5e3))
    quality = ShiftQuality(score=90.0, reasons=(), parts=ShiftParts(), packs=packs)
    return replace(result, estimate=replace(result.estimate, shift_quality=quality))


def _later(records: Iterable[object]) -> list[object]:
    """Return the values of the field that is more."""
    return [getattr(record, FIELD) for record in records]


def _lake(address: str) -> dict[str, Any]:
    """Return what rows of a lake become that an earlier program wrote, as read, put together, and without a vehicle."""

    def later() -> list[str]:
        return [
            f"{row.source}: {getattr(row, FIELD)}" for row in sorted(Manifest(place).rows, key=lambda row: row.source)
        ]

    place = Place(address)
    answers = {"lake": later()}
    Manifest(place).put_together()
    answers["together"] = later()
    Manifest(place).forget("car2")
    return answers | {"forgotten": later()}


def _store(path: Path) -> dict[str, Any]:
    """Return what is read of the store of an earlier program, which takes receipts, and results with their state."""
    with StoreReader.open(path) as reader:
        results, fills = [row.result for row in reader.rows("car1")], reader.fills("car1")
    with closing(ResultStore.open(path)) as store:
        positions = store.note_receipts([Receipt(key=key_of(shift_record(result))) for result in results])
        added = [store.add(result, STATE) for result in history(len(results) + 1)]
        state, ends = store.state("car1"), store.ends("car1", VERSIONS)
    return {
        "stored fits": _later(result.estimate.fit for result in results),
        "stored fills": _later(fills),
        "receipts": len(positions),
        "added": sum(added),
        "has state": state is not None and state.versions == VERSIONS,
        "ends of streams": len(ends),
        "kept events": _later(kept_event(file)[0] for file in path.with_name(f"{path.name}.events").iterdir()),
    }
