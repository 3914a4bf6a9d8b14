"""Each record of results, messages, lake and fleet gets one more field with a default, and the fleet is played."""

import json
import subprocess
import sys
from http import HTTPStatus
from pathlib import Path

from clutch_model.calibration import nominal_calibration
from clutch_results.records import FluidFill
from dbc.contract import load_contract
from diag_service.diagnosis.events import Event
from diag_service.lake.parts import DONE, LogRow, Manifest, Place
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from diag_service.store import KeptEvents
from ecu_emulator.drive.recording import Drive
from tests.support.builders import drive_scenario
from tests.support.distributions import ROOT
from tests.support.histories import fill_store, history
from tests.support.wider_records import DEFAULT
from tests.support.wire import received

PLAYED_S = 300.0  # reached by what hangs only
WIDER = {  # of all that are, those that a file, a message or a table holds
    *(f"clutch_results.records.{name}" for name in ("EventConditions", "EventFit", "FluidFill", "ShiftEstimate")),
    *("clutch_results.event_kinds.ShiftQuality", "clutch_results.prognosis.history.History"),
    *("diag_service.diagnosis.events.Event", "diag_service.lake.parts.LogRow", "fleet_contract.messages.ResultKey"),
    *(f"fleet_backend.ageing.records.{name}" for name in ("ClutchNow", "Due", "Fill")),
}


def log_row(source: str, vehicle: str) -> LogRow:
    return LogRow(
        source=source,
        key=source,
        size_bytes=1,
        vehicle=vehicle,
        content=source,
        settings="",
        signals="",
        algorithm_version="algorithm-1",
        outcome=DONE,
        reason="",
        shifts=0,
        parts=(),
        account='{"logs":[]}',
        made_at="2026-03-01T12:00:00.000000Z",
    )


def first_event() -> Event:
    stages = Stages(Decoder(load_contract(), load_profile()), nominal_calibration())
    return stages.segment(received(next(Drive(drive_scenario()).stretches(10.0)).frames))[0]


def test_one_more_field_with_a_default_in_every_record_changes_nothing(postgres_url: str, tmp_path: Path) -> None:
    """What was written before lacks it, and so do the tables of the database and the messages."""
    lake, store = Place(str(tmp_path / "lake")), tmp_path / "car1.sqlite"
    Manifest(lake).add([log_row("a.log", "car1")])
    Manifest(lake).add([log_row("b.log", "car2")])
    fill_store(store, history(6), [FluidFill(vehicle="car1", filled_at="2026-01-01T00:00:00.000000Z")])
    KeptEvents.beside(store).keep(first_event(), "a fault")
    words = (postgres_url, str(tmp_path / "lake"), str(store))
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.wider_records", "tests.support.wider_fleet", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=PLAYED_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    answers = json.loads(done.stdout)
    assert set(answers.pop("records")) >= WIDER
    assert answers == {
        "stored fits": [DEFAULT] * 6,
        "stored fills": [DEFAULT],
        "receipts": 6,
        "added": 1,
        "has state": True,
        "ends of streams": 2,
        "kept events": [DEFAULT],
        "lake": [f"a.log: {DEFAULT}", f"b.log: {DEFAULT}"],
        "together": [f"a.log: {DEFAULT}", f"b.log: {DEFAULT}"],
        "forgotten": [f"a.log: {DEFAULT}"],
        "came in as": ["FILLS", "SHIFT"],
        "clutches now": [DEFAULT] * 2,
        "estimates": [DEFAULT] * 2,
        "conditions": [DEFAULT] * 2,
        "qualities": [DEFAULT] * 2,
        "fits": [DEFAULT] * 2,
        "fleet fills": [DEFAULT],
        "foretold": [True] * 2,
        "due clutches": [1, 2],
        "pages": [HTTPStatus.OK] * 4,
        "columns of the table": 1,
        "has alarms": True,
        "has shift": True,
    }
