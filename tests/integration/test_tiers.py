"""Fewer signals, less said: never a friction below the first tier, and what is missing by name."""

import json
import re
import shutil
import statistics
from pathlib import Path

import pytest

from diag_service.mapping.profile import PROFILE_PATH
from ecu_emulator.cli import main as emulator
from tests.support.in_process import ended as run
from tests.support.service import Ended

SHIFT_COUNT = 3


def profile_without(folder: Path, *words: str) -> Path:
    """Return our profile without the lines that hold one of the words."""
    lines = PROFILE_PATH.read_text(encoding="utf-8").splitlines()
    path = folder / "less.toml"
    path.write_text("\n".join(line for line in lines if not any(word in line for word in words)), encoding="utf-8")
    return path


def ratios(ended: Ended) -> list[float]:
    return [shift["indices"]["torque_capacity_ratio"] for shift in ended.shifts]


def says_friction(ended: Ended) -> bool:
    """Return whether a coefficient is printed anywhere."""
    return any(key in ended.out for key in ('"mu_c"', '"mu_s"'))


def test_torque_only(drive_log: Path, tmp_path: Path) -> None:
    profile = profile_without(tmp_path, "clutch1_pressure", "clutch2_pressure")
    ended = run("analyze", drive_log, "--profile", profile, "--json")
    assert (ended.status, ended.err) == (0, "")
    assert [(shift["tier"], shift["friction"], shift["status"]) for shift in ended.shifts] == [
        (2, None, "unobserved")
    ] * SHIFT_COUNT
    assert statistics.mean(ratios(ended)) == pytest.approx(1.0, abs=0.1)  # production scatter included
    assert not says_friction(ended)
    capability = ended.summary["capability"]
    assert (capability["tier"], capability["missing"]) == (2, "friction needs clutch 1 pressure, clutch 2 pressure")


def test_a_folder_of_such_logs_has_no_verdicts_to_list(drive_log: Path, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    shutil.copy(drive_log, tmp_path / "logs" / "drive.log")
    profile = profile_without(tmp_path, "clutch1_pressure", "clutch2_pressure")
    ended = run("analyze", tmp_path / "logs", "--profile", profile)
    assert ended.status == 0
    assert ", tier 2, 3 shifts (3 unobserved), friction cannot be known from this car" in ended.out
    assert "no verdict" not in ended.out


def test_speeds_and_gears_only_with_ratios_for_gears(drive_log: Path, tmp_path: Path) -> None:
    ended = run("analyze", drive_log, "--profile", profile_without(tmp_path, "pressure", "torque"), "--json")
    assert [(shift["tier"], shift["friction"]) for shift in ended.shifts] == [(3, None)] * SHIFT_COUNT
    assert ratios(ended) == [None] * SHIFT_COUNT
    assert all(shift["indices"]["peak_slip_rad_s"] > 50.0 for shift in ended.shifts)
    assert not says_friction(ended)


def test_a_worn_clutch_carries_less_than_it_is_asked_for(tmp_path: Path) -> None:
    log = tmp_path / "aged.log"
    assert emulator(["record", str(log), "--scenario", "case2"]) == 0
    drive = json.loads(log.with_name("aged.log.truth.jsonl").read_text(encoding="utf-8").splitlines()[0])
    profile = profile_without(tmp_path, "clutch1_pressure", "clutch2_pressure")
    ended = run("analyze", log, "--profile", profile, "--json")
    least, most = min(drive["mu_c"]) / 0.140, max(drive["mu_s"]) / 0.119
    assert (least < 0.9, most > 1.1) == (True, True)  # aged fluid grips more when nearly closed and less at speed
    stds = [shift["indices"]["std_torque_capacity_ratio"] for shift in ended.shifts]
    assert all(least - 2.0 * std < ratio < 1.0 for ratio, std in zip(ratios(ended), stds, strict=True))


def test_a_log_without_shifts_is_accounted_for(drive_log: Path, tmp_path: Path) -> None:
    ended = run("analyze", drive_log, "--profile", "j1939")
    assert ended.status == 0
    assert "profile j1939: 12 of 12 signals, tier 3; torque capacity needs" in ended.err
    lines = len(drive_log.read_bytes().splitlines())
    assert f"{lines} frames, 0 decoded, {lines} ignored" in ended.out
    assert "no shift was found; the signals do not show shifts: shift time and slip need engine speed" in ended.out
    assert "mapped by profile j1939, but never seen: engine_speed_rad_s, pedal_ratio" in ended.out


def test_a_car_without_pressures_tells_slip_capacity_and_what_friction_would_need(
    drive_log: Path, tmp_path: Path
) -> None:
    profile = profile_without(tmp_path, "clutch1_pressure", "clutch2_pressure")
    lines = run("analyze", drive_log, "--profile", profile).out.splitlines()
    assert (
        " ".join(lines[0].split()) == "shift gears event clutch slip time peak slip heat ± 2 std capacity ± 2 std score"
    )
    first = next(line for line in lines if " 1-2 " in line)
    assert re.search(
        r"power on upshift +2 +\d\.\d\d s +\d+ rpm +\d+\.\d\d ± \d\.\d\d kJ +\d\.\d\d ± \d\.\d\d +\d+$", first
    )
    text = "\n".join(lines)
    assert not re.search("unobserved|signal missing|no verdict$|engaged it|condition", text, re.MULTILINE)
    assert text.count("friction cannot be known from this car") == 1
    assert "-: not measured" in text
    assert f"Friction: cannot be known from this car; shifting: {SHIFT_COUNT} events; power on upshift" in text
    assert "  clutch 1 pressure: asked for by 22 38EB at 7E1 (profile dct_asked)" in lines
    assert "  At the car, diag-service try --profile dct_asked --active asks for them" in text
    summary = run("analyze", drive_log, "--profile", profile, "--json").summary
    (row,) = (row for row in summary["shifting"]["rows"] if (row["from_gear"], row["to_gear"]) == (1, 2))
    shift = next(s for s in run("analyze", drive_log, "--profile", profile, "--json").shifts if s["to_gear"] == 2)
    for key in ("slip_duration_s", "peak_slip_rad_s", "torque_capacity_ratio"):
        assert row["measures"][key]["mean"] == pytest.approx(shift["indices"][key])
    assert row["measures"]["torque_capacity_ratio"]["std"] == shift["indices"]["std_torque_capacity_ratio"]
    assert [need["signal"] for need in summary["capability"]["needs"]] == ["clutch1_pressure_pa", "clutch2_pressure_pa"]


def test_a_car_of_speeds_tells_shift_time_slip_and_jerk(drive_log: Path, tmp_path: Path) -> None:
    ended = run("analyze", drive_log, "--profile", profile_without(tmp_path, "pressure", "torque"))
    head, *lines = ended.out.splitlines()
    assert " ".join(head.split()) == "shift gears event clutch shift time slip time peak slip jerk ± 2 std ratio after"
    cells = r"\d\.\d\d s +\d\.\d\d s +\d+ rpm +(-|\d+\.\d ± \d+\.\d m/s³) +\d+\.\d{3}$"
    assert all(re.search(cells, line) for line in lines[:SHIFT_COUNT])
    assert "capacity" not in head + "".join(lines[:SHIFT_COUNT])
    assert "tier 3 of 3, shift time and slip, no friction" in ended.out
    assert "  engine torque: asked for by 22 100C at 7E1 (profile dct_asked)" in ended.out


def test_where_friction_is_told_nothing_speaks_of_shifting_instead(drive_log: Path) -> None:
    ended = run("analyze", drive_log)
    assert not re.search("How it shifts|Friction:|would be needed", ended.out)
    assert "shifting" not in run("analyze", drive_log, "--json").summary


def test_the_request_of_another_maker_is_no_advice(drive_log: Path, tmp_path: Path) -> None:
    profile = profile_without(tmp_path, "clutch1_pressure", "clutch2_pressure")
    profile.write_text(profile.read_text(encoding="utf-8").replace('"dct"', '"my_car"'), encoding="utf-8")
    text = run("analyze", drive_log, "--profile", profile).out
    assert "38EB" not in text
    assert "clutch 1 pressure, clutch 2 pressure: not among what was read, and no request is known for this car" in text
    assert "diag-service scan --active finds who can be asked" in text
