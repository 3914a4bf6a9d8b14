"""An automatic with a lock-up clutch, emulated and diagnosed from its log: friction, shudder, verdict, by its name."""

import json
import re
from pathlib import Path

import pytest

import diag_service
from clutch_results.records import shift_record
from diag_service.mapping.profile import PROFILE_FOLDER
from ecu_emulator import Emulator
from tests.support.in_process import ended


@pytest.fixture(name="log", scope="module")
def _log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lockup") / "old.log"
    Emulator("lockup", fluid="case2", seed=13, drive="us06").record(path)
    return path


def told(log: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in Path(f"{log}.truth.jsonl").read_text(encoding="utf-8").splitlines()]


def test_old_fluid_is_told_by_slip_and_by_shudder(log: Path) -> None:
    found = diag_service.analyze(log, profile="lockup")
    verdict = found.verdicts[1]
    assert list(found.verdicts) == [1]
    assert verdict.element == "lock-up clutch"
    assert verdict.condition is diag_service.Condition.CHANGE_FLUID
    micro = verdict.micro_slip
    assert micro is not None
    drive, *_ = told(log)
    at_slip, drawn = drive["mu_at_slip_rpm"], drive["drawn"]
    assert isinstance(at_slip, dict)
    assert isinstance(drawn, dict)
    shown = at_slip["40"] * (1.0 + drawn["torque_gain_ratio"]) * (1.0 + drawn["clutch1_piston_area_ratio"])
    assert abs(micro.mu - at_slip["40"]) < 3.0 * micro.std_mu
    assert abs(micro.scale_free_mu - shown) < 3.0 * micro.std_scale_free_mu
    assert micro.slope_s_rad < 0.0
    records = [shift_record(one) for one in found.results]
    assert {one["element"] for one in records} == {"lock-up clutch"}
    assert any(one["kind"] == "shudder" for one in told(log))
    swings = [one.estimate.micro_slip.shudder for one in found.results if one.estimate.micro_slip is not None]
    assert max(one.seen_count for one in swings if one is not None) >= 3
    assert "lock-up clutch change fluid" in repr(found)
    assert found.plot().axes[0].lines[0].get_label() == "Lock-up clutch"


def test_store_history_and_report_call_it_by_its_name(log: Path, tmp_path: Path) -> None:
    store, page = tmp_path / "car.sqlite", tmp_path / "page.html"
    words = ("--profile", "lockup", "--calibration", "lockup", "--vehicle", "at8")
    run = ended("analyze", str(log), *words, "--store", str(store))
    assert "Lock-up clutch: it can shudder" in run.out
    history = ended("history", str(store), "--calibration", "lockup").out
    assert "Lock-up clutch, fluid by fluid" in history
    assert "lutch 2" not in history
    ended("report", str(store), "--calibration", "lockup", "-o", str(page), "--full")
    html = page.read_text(encoding="utf-8")
    assert "Lock-up clutch: friction over slip" in html
    ended("report", str(log), "--profile", "lockup", "-o", str(page), "--force", "--full")
    assert "turbine" in page.read_text(encoding="utf-8")
    assert "Lock-up clutch: running estimate" in html
    assert "slope at 40 rpm" in html
    assert "lutch 2" not in html


def test_by_speeds_alone_slip_is_told_and_no_event_is_waited_for(log: Path, tmp_path: Path) -> None:
    shipped = (PROFILE_FOLDER / "lockup.toml").read_text(encoding="utf-8")
    lines = [line for line in shipped.splitlines() if "lockup_pressure" not in line and "database" not in line]
    (tmp_path / "speeds.toml").write_text("\n".join(lines), encoding="utf-8")
    options = (
        "--profile",
        tmp_path / "speeds.toml",
        "--dbc",
        PROFILE_FOLDER.parents[1] / "dbc" / "lockup.dbc",
        "--calibration",
        "lockup",
    )
    text = ended("analyze", log, *options).out
    assert "There is no verdict on the fluid: friction cannot be known from this car." in text
    assert re.search(r"  Slip under 4 rpm for \d+ s, up to 95 rpm for [1-9]\d* s, more for [1-9]\d* s\.", text)
    assert re.search(r"Shudder: seen, at \d+\.\d Hz", text)
    assert "  lock-up pressure: not among what was read" in text
    assert not re.search("engaged it|yet", text)
    slip = ended("analyze", log, *options, "--json").summary["lockup_slip"]
    assert slip["held_s"] > 10.0
    assert ended("report", log, *options, "-o", tmp_path / "page.html").status == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Slip went below 95 rpm" in page
    assert "no event engaged" not in page
