"""What a store tells of the past: fluid by fluid, event by event, and what it leaves out."""

from dataclasses import replace
from pathlib import Path

from rich.text import Text

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.prognosis import ChannelName, PeerGroup, Peers, Population, Usual
from diag_service.diagnosis.records import FluidFill, utc_from_bus_ns
from diag_service.report.findings import findings_of_store
from diag_service.report.history import history_lines, history_records, periods_of
from diag_service.store import Versions
from tests.support.histories import VERSIONS, fill_store, findings, history, of_version

CALIBRATION = nominal_calibration()


def fill_at(seq: int) -> FluidFill:
    start_ns = history(40)[seq - 1].estimate.start_ns
    return FluidFill(vehicle="car1", filled_at=utc_from_bus_ns(start_ns), product="DCTF-II")


def test_results_belong_to_the_fluid_of_their_moment() -> None:
    found = replace(findings(40), fills=(fill_at(21),))
    old, new = periods_of(found, 1)
    assert [row.position for row in old.rows] == list(range(1, 21, 2))
    assert [row.position for row in new.rows] == list(range(21, 41, 2))
    assert (old.name, new.name.startswith("DCTF-II since 2026-01-01")) == ("fluid of unknown age", True)


def test_every_event_is_a_record_and_the_last_one_has_the_fills() -> None:
    found = replace(findings(40), fills=(fill_at(21),))
    *events, fills = history_records(found, (1, 2))
    assert len(events) == 40
    assert {record["clutch"] for record in events} == {1, 2}
    first = events[0]
    verdict = found.rows[0].result.verdict
    assert verdict.friction is not None
    assert (first["shift"], first["running_mu_c"], first["advice"]) == (1, verdict.friction.mu_c, verdict.advice)
    assert [record["fluid_since"] for record in events[:20]] == [None] * 10 + [fill_at(21).filled_at] * 10
    assert fills["fills"] == [
        {"filled_at": fill_at(21).filled_at, "odometer_m": None, "product": "DCTF-II", "note": None}
    ]


def test_prognoses_begin_with_what_a_fleet_taught() -> None:
    found = findings(40)
    usual = Usual(start=1.0, start_std=0.02, loss_per_m=5.0e-8, loss_log_std=0.1)
    assert found.calibration is not None
    kind = PeerGroup(vehicle_type=found.calibration.name, fluid=None)
    peers = Peers(kind=kind, life_count=77, channels={ChannelName.MARGIN: usual})
    told = [
        [line.plain for line in history_lines(found, (1,), most_rows=5, population=one) if isinstance(line, Text)]
        for one in (None, Population(life_count=77, peers=(peers,)), Population(life_count=0, peers=()))
    ]
    alone, among, strangers = (lines[4] for lines in told)
    assert among.endswith(" Before its own results: as 77 lives of its peers.")
    assert among.split(" Before")[0] != alone == strangers


def test_a_store_gives_the_results_of_its_newest_versions(tmp_path: Path) -> None:
    old = Versions(algorithm="impulse-0", calibration=VERSIONS.calibration)
    fill_store(tmp_path / "car1.sqlite", [of_version(one, old) for one in history(3)] + history(8), [fill_at(5)])
    found = findings_of_store(tmp_path / "car1.sqlite", None, CALIBRATION)
    assert (len(found.rows), found.left_out_count, found.versions) == (8, 3, VERSIONS)
    assert found.calibration == CALIBRATION
    assert found.fills == (fill_at(5),)
    other = replace(CALIBRATION, version="another")
    assert findings_of_store(tmp_path / "car1.sqlite", "car1", other).calibration is None
