"""Fewer signals, less said: never a friction below the first tier, and what is missing by name."""

import json
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
