"""A scan tool's table of an automatic with commanded pressure: proposed, analysed, reported; no level, but a slope."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from canlog.arrays import Series
from diag_service.diagnosis.columns import Signal
from studies.converter_car import ConverterCar, drive
from studies.scan_tool import of_automatic
from tests.support.in_process import ended

RPM, PSI, LB_FT, DEGF = np.pi / 30.0, 6894.757, 1.355818, 5.0 / 9.0
NAMES = {  # as HP Tuners' users have them, and which scale and offset their units have
    Signal.TURBINE_SPEED: ("turbine_rpm", RPM, 0.0),
    Signal.LOCKUP_SLIP: ("tcc_slip_rpm", RPM, 0.0),
    Signal.LOCKUP_SLIP_COMMAND: ("tcc_desired_slip_rpm", RPM, 0.0),
    Signal.LOCKUP_PRESSURE_COMMAND: ("tcc_line_pressure", PSI, 0.0),
    Signal.ENGINE_TORQUE: ("trans_engine_torque_nm", LB_FT, 0.0),
    Signal.CURRENT_GEAR: ("trans_gear_actual", 1.0, 0.0),
    Signal.SUMP_TEMPERATURE: ("trans_fluid_temp_c", DEGF, 273.15 - 32.0 * DEGF),
}


def write_automatic(path: Path, told: Mapping[Signal, Series]) -> None:
    """Write a table in which each row holds the channels that were told at that moment."""
    t_ns = np.unique(np.concatenate([series.t_ns for series in told.values()]))
    cells = np.full((len(t_ns), len(told)), "", dtype=object)
    for place, (signal, series) in enumerate(told.items()):
        _, scale, offset = NAMES[signal]
        values = np.round((series.value - offset) / scale, 6).tolist()
        cells[np.searchsorted(t_ns, series.t_ns), place] = list(map(str, values))
    lines = [",".join(["time_s", *(NAMES[signal][0] for signal in told)])]
    lines += [",".join([f"{t / 1e9:.3f}", *row]) for t, row in zip(t_ns.tolist(), cells.tolist(), strict=True)]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


@pytest.fixture(name="table", scope="module")
def _table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(21)
    path = tmp_path_factory.mktemp("automatic") / "drive.csv"
    write_automatic(path, of_automatic(drive(ConverterCar(followed_ratio=1.0), rng, 8.0).columns, rng))
    return path


def test_it_is_proposed_analysed_and_reported(table: Path, tmp_path: Path) -> None:
    profile, page = tmp_path / "p.toml", tmp_path / "page.html"
    profile.write_text(ended("signals", str(table)).out, encoding="utf-8")
    assert "reaches tier 2" in profile.read_text(encoding="utf-8")
    shown = ended("analyze", "--profile", str(profile), str(table)).out
    assert "level of friction is withheld: pressure is commanded" in shown
    assert "rises, positive with" in shown
    assert "no shift was found" not in shown
    assert "Pressure follows the torque model" in shown
    summary = json.loads(ended("analyze", "--json", "--profile", str(profile), str(table)).out.splitlines()[-1])
    slope = summary["lockup_slope"]
    together, lining = (slope["slopes"][0][name] for name in ("together", "lining"))
    assert slope["feed_forward_r2"] > 0.9
    assert together["low_s_rad"] > 0.0
    assert lining["low_s_rad"] < 0.021 / 6.0 * 0.5 / 0.13 < lining["high_s_rad"]
    assert summary["clutches"] == []
    ended("report", "--profile", str(profile), str(table), "-o", str(page))
    html = page.read_text(encoding="utf-8")
    assert '<h2 id="lockup">Lock-up clutch</h2>' in html
    assert "Torque at fixed pressure for 10 rpm more slip" in html
    assert "no event engaged it" not in html
