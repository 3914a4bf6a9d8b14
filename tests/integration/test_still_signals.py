"""A bus whose gear signals and input speed never move is read without them, and says so; a standing car is not."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import diag_service
from canlog.arrays import Series
from canlog.database.loading import load_database
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.profile import load_profile
from ecu_emulator.cli import main as emulator
from tests.support.in_process import ended
from tests.support.recode import Drive, drive_of, recoded, write_candump
from tests.support.service import Ended

DATA = Path(__file__).parents[1] / "data"
DBC, PROFILE = DATA / "carmaker.dbc", DATA / "carmaker.toml"
ROLLED_M = 0.09  # for a radian of the output shaft
STILL = (Signal.INPUT_SPEED, Signal.CURRENT_GEAR)


def at(series: Series, value: float) -> Series:
    return replace(series, value=np.full(len(series.value), value))


@pytest.fixture(name="drive", scope="module")
def _drive(cycle_log: Path) -> Drive:
    drive = drive_of(cycle_log)
    output = drive[Signal.OUTPUT_SPEED]
    drive[Signal.VEHICLE_SPEED] = replace(output, value=ROLLED_M * output.value)
    return drive


def written(drive: Drive, path: Path, *still: Signal) -> Path:
    """Write a drive as frames of the made-up carmaker; some signals stand at zero."""
    changed = {signal: at(series, 0.0) if signal in still else series for signal, series in drive.items()}
    write_candump(path, recoded(changed, load_database(DBC), load_profile(PROFILE)))
    return path


def analysed(log: Path, *words: str | Path) -> Ended:
    return ended("analyze", log, "--dbc", DBC, "--profile", PROFILE, *words)


def test_gears_and_input_that_never_move_are_told_and_the_drive_is_read_by_its_speeds(
    drive: Drive, tmp_path: Path
) -> None:
    log, whole = written(drive, tmp_path / "still.log", *STILL), written(drive, tmp_path / "whole.log")
    shown, told = analysed(log, "--json"), analysed(whole, "--json")
    assert "GE_Wellen.GE_Eingangsdrehzahl is 0 throughout: taken as absent (input shaft speed; " in shown.err
    assert "GE_Gang.GE_Gang_Ist is 0 throughout: taken as absent (current gear; " in shown.err
    assert "absent" not in told.err
    capability, before = shown.summary["capability"], told.summary["capability"]
    assert [text.split(" is 0 throughout")[0] for text in capability["absent"]] == [
        "GE_Wellen.GE_Eingangsdrehzahl", "GE_Gang.GE_Gang_Ist",
    ]  # fmt: skip
    assert "absent" not in before
    assert (capability["tier"], before["tier"]) == (3, 2)
    assert "input shaft speed" in capability["missing"]
    changes = [[(shift["from_gear"], shift["to_gear"]) for shift in run.shifts] for run in (shown, told)]
    assert changes[0] == changes[1]
    assert len(changes[0]) == 10
    times = [shift["indices"]["shift_time_s"] for shift in shown.shifts]
    assert all(time_s is not None and 0.1 < time_s < 3.0 for time_s in times)


def test_without_any_gear_signal_gears_come_from_the_speeds(drive: Drive, tmp_path: Path) -> None:
    log = written(drive, tmp_path / "still.log", *STILL, Signal.TARGET_GEAR)
    shown = analysed(log, "--json")
    assert shown.err.count("taken as absent") == 3
    assert len(shown.shifts) == 10
    assert {abs(shift["to_gear"] - shift["from_gear"]) for shift in shown.shifts} == {1}


def test_python_and_the_report_say_the_same(drive: Drive, tmp_path: Path) -> None:
    log = written(drive, tmp_path / "still.log", *STILL)
    analysis = diag_service.analyze([log], dbc=DBC, profile=PROFILE)
    assert sum("taken as absent" in notice for notice in analysis.notices) == 2
    assert analysis.summary["capability"]["tier"] == 3
    page = tmp_path / "page.html"
    shown = ended("report", log, "--dbc", DBC, "--profile", PROFILE, "-o", page)
    assert (shown.status, shown.err.count("taken as absent")) == (0, 2)
    assert page.read_text(encoding="utf-8").count("GE_Gang.GE_Gang_Ist is 0 throughout: taken as absent") >= 1


def test_signals_tells_it_and_proposes_a_profile_without_them(drive: Drive, tmp_path: Path) -> None:
    log, profile = written(drive, tmp_path / "still.log", *STILL), tmp_path / "car.toml"
    text = ended("signals", log, "--dbc", DBC).out
    profile.write_text(text, encoding="utf-8")
    assert "# As it stands it reaches tier 3" in text
    assert "# GE_Wellen.GE_Eingangsdrehzahl is 0 throughout: taken as absent (input shaft speed; " in text
    assert "# GE_Gang.GE_Gang_Ist is 0 throughout: taken as absent (current gear; " in text
    sources = load_profile(profile).sources
    assert not sources.keys() & set(STILL)
    assert sources[Signal.TARGET_GEAR].place == "GE_Gang.GE_Zielgang"
    whole = ended("signals", written(drive, tmp_path / "whole.log"), "--dbc", DBC).out
    assert "absent" not in whole
    assert "# As it stands it reaches tier 2" in whole


def test_nothing_is_absent_in_a_standing_car(drive: Drive, tmp_path: Path) -> None:
    speeds = (Signal.INPUT_SPEED, Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED)
    standing = written(drive, tmp_path / "standing.log", *speeds, Signal.CURRENT_GEAR, Signal.TARGET_GEAR)
    shown = analysed(standing, "--json")
    assert "absent" not in shown.err
    assert shown.summary["capability"]["tier"] == 2


def test_gears_may_stand_still_in_a_drive_in_one_gear(drive: Drive, tmp_path: Path) -> None:
    ratio = 12.0
    output = drive[Signal.OUTPUT_SPEED]
    swing = 40.0 + 15.0 * np.sin((output.t_ns - output.t_ns[0]) / 4e9)
    one_gear = dict(drive) | {
        Signal.VEHICLE_SPEED: replace(output, value=ROLLED_M * swing),
        Signal.CURRENT_GEAR: at(drive[Signal.CURRENT_GEAR], 2.0),
        Signal.TARGET_GEAR: at(drive[Signal.TARGET_GEAR], 2.0),
    }
    for signal in (Signal.ENGINE_SPEED, Signal.INPUT_SPEED):
        series = drive[signal]
        one_gear[signal] = replace(series, value=ratio * np.interp(series.t_ns, output.t_ns, swing))
    assert "absent" not in analysed(written(one_gear, tmp_path / "one.log")).err
    shown = analysed(written(one_gear, tmp_path / "still.log", Signal.INPUT_SPEED), "--json")
    assert shown.err.count("taken as absent") == 1
    assert "GE_Eingangsdrehzahl is 0 throughout" in shown.err


def test_a_log_that_another_profile_reads_better_says_which(tmp_path: Path) -> None:
    log = tmp_path / "lockup.log"
    assert emulator(["record", str(log), "--scenario", "lockup", "--drive", "us06"]) == 0
    shown = ended("analyze", log)
    assert "this log holds the messages of profile lockup, which reaches tier 1: --profile lockup" in shown.err
    assert "taken as absent" not in shown.err
    better = ended("analyze", log, "--profile", "lockup", "--calibration", "lockup", "--json")
    assert "this log holds" not in better.err
    assert better.summary["capability"]["tier"] == 1


def test_a_log_that_its_profile_reads_well_hears_of_no_other(drive_log: Path) -> None:
    well = ended("analyze", drive_log).err
    assert "this log holds" not in well
    assert "absent" not in well
    shown = ended("analyze", drive_log, "--profile", "lockup", "--json")
    assert "this log holds the messages of profile dct, which reaches tier 1: --profile dct" in shown.err
    assert json.loads(shown.out.splitlines()[-1])["capability"]["tier"] is None
