"""A scan tool's table with a column that is not what it is called: physics chooses, and the drive is read rightly."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canlog.arrays import FloatArray, Int64Array
from clutch_model.units import rpm_from_rad_s
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.shifts.tracking import held_values
from ecu_emulator import Emulator
from tests.support.in_process import ended
from tests.support.recode import Drive, lockup_drive_of

ROW_S = 0.025
DRIVEN_NS = 300 * 10**9  # of the drive
RPM = rpm_from_rad_s(1.0)
NAMES = {  # as HP Tuners names an Allison behind a diesel
    Signal.ENGINE_SPEED: ("Engine RPM", "rpm", RPM, 0.0),
    Signal.TURBINE_SPEED: ("Trans Turbine RPM", "rpm", RPM, 0.0),
    Signal.LOCKUP_SLIP: ("TCC Slip", "rpm", RPM, 0.0),
    Signal.LOCKUP_PRESSURE_COMMAND: ("TCC Desired Pressure", "bar", 1e-5, 0.0),
    Signal.ENGINE_TORQUE: ("Delivered Engine Torque", "Nm", 1.0, 0.0),
    Signal.OUTPUT_SPEED: ("Trans Output Shaft RPM", "rpm", RPM, 0.0),
    Signal.CURRENT_GEAR: ("Trans Current Gear", "", 1.0, 0.0),
    Signal.SUMP_TEMPERATURE: ("Trans Fluid Temp", "degC", 1.0, -273.15),
}
PUMP = "Trans Input Shaft RPM"  # which is engine speed

Table = dict[tuple[str, str], FloatArray]


@pytest.fixture(name="drive", scope="module")
def _drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    path = tmp_path_factory.mktemp("lockup") / "drive.log"
    Emulator("lockup", seed=13, drive="us06").record(path)
    return lockup_drive_of(path)


def rows_of(drive: Drive) -> Int64Array:
    engine = drive[Signal.ENGINE_SPEED]
    first_ns = int(engine.t_ns[0]) + 10**9
    return np.arange(first_ns, first_ns + DRIVEN_NS, int(1e9 * ROW_S), dtype=np.int64)


def table_of(drive: Drive) -> Table:
    """Return the table's columns by name and unit."""
    t_ns = rows_of(drive)
    held = {signal: held_values(drive[signal], t_ns, np.nan) for signal in NAMES}
    return {(name, unit): held[signal] * scale + more for signal, (name, unit, scale, more) in NAMES.items()}


def written(path: Path, table: Mapping[tuple[str, str], FloatArray]) -> Path:
    head = "Offset," + ",".join(name for name, _ in table) + "\ns," + ",".join(unit for _, unit in table)
    rows = np.column_stack([ROW_S * np.arange(len(next(iter(table.values())))), *table.values()])
    np.savetxt(path, rows, fmt="%.3f", delimiter=",", header=head, comments="")
    return path


def slope_of(path: Path) -> dict[str, Any]:
    shown = ended("analyze", path, "--json")
    assert shown.status == 0
    slope = json.loads(shown.out.splitlines()[-1])["lockup_slope"]
    assert isinstance(slope, dict)
    return slope


def contests(path: Path) -> tuple[list[str], list[str]]:
    """Return the lines of contests that `signals` prints, and those of its profile."""
    lines = ended("signals", path).out.splitlines()
    return [line for line in lines if "Contest" in line], [line for line in lines if " = {" in line]


@pytest.mark.parametrize("is_first", [True, False])
def test_the_pump_is_not_taken_for_the_turbine(drive: Drive, tmp_path: Path, *, is_first: bool) -> None:
    table, pump = table_of(drive), {(PUMP, "rpm"): table_of(drive)["Engine RPM", "rpm"]}
    without = written(tmp_path / "without.csv", table)
    both = written(tmp_path / "with.csv", pump | table if is_first else table | pump)
    (contest,), profile = contests(both)
    assert contest.startswith(
        "# Contest for turbine speed, by engine less turbine speed against slip: 'Trans Turbine RPM'"
    )
    assert contest.endswith("chosen: 'Trans Turbine RPM' (sure)")
    assert any(line.startswith('turbine_speed_rad_s = { column = "Trans Turbine RPM"') for line in profile)
    assert contests(without)[0] == []
    right, found = slope_of(without), slope_of(both)
    assert right["slip_s"] > 10.0
    assert right == found


def test_the_pump_alone_is_told_and_not_taken_for_the_turbine(drive: Drive, tmp_path: Path) -> None:
    table = table_of(drive)
    pump = {(PUMP, "rpm"): table["Engine RPM", "rpm"]}
    rest = {key: value for key, value in table.items() if key[0] != "Trans Turbine RPM"}
    (contest,), profile = contests(written(tmp_path / "pump.csv", pump | rest))
    assert f"it is engine speed: '{PUMP}'" in contest
    assert "(none fits)" in contest
    assert not any("turbine_speed_rad_s" in line and not line.startswith("#") for line in profile)


def test_two_engine_speeds_and_two_temperatures_are_told(drive: Drive, tmp_path: Path) -> None:
    table = table_of(drive)
    rng = np.random.default_rng(4)
    table["Engine Speed", "rpm"] = np.maximum(
        table["Engine RPM", "rpm"] + rng.normal(0.0, 1.0, len(rows_of(drive))), 0.0
    )
    table["Trans Oil Temp", "degC"] = table["Trans Fluid Temp", "degC"] - 4.0
    found, _ = contests(written(tmp_path / "double.csv", table))
    engine, oil = found
    assert "'Engine RPM'" in engine
    assert engine.endswith("(nearly equal on this log: chosen by name)")  # they differ nowhere by more than noise
    assert oil.endswith("(by name only: no relation of physics tells them apart)")


def test_units_that_nothing_says_come_from_what_an_engine_and_gears_can(drive: Drive, tmp_path: Path) -> None:
    table = table_of(drive)
    bare = {
        (name, ""): value / (RPM if unit == "rpm" and name != "Trans Output Shaft RPM" else 1.0)
        for (name, unit), value in table.items()
    }
    named = {(name.replace(" RPM", " Speed"), unit): value for (name, unit), value in bare.items()}
    profile = contests(written(tmp_path / "bare.csv", named))[1]
    units = {line.split(" = ")[0]: line.split('unit = "')[1].split('"')[0] for line in profile if line[0] != "#"}
    assert units["engine_speed_rad_s"] == "rad/s"
    assert units["turbine_speed_rad_s"] == "rad/s"
    assert units["output_speed_rad_s"] == "rpm"
    assert units["lockup_pressure_command_pa"] == "bar"


def test_a_parked_car_tells_nothing_and_the_name_chooses(drive: Drive, tmp_path: Path) -> None:
    table = table_of(drive)
    count = 2000
    parked = {key: np.full(count, value[0]) for key, value in table.items()}
    idle = 700.0 + np.random.default_rng(5).normal(0.0, 2.0, count)
    for name in ("Engine RPM", "Trans Turbine RPM"):
        parked[name, "rpm"] = idle
    parked["TCC Slip", "rpm"] = np.zeros(count)
    (contest,), _ = contests(written(tmp_path / "parked.csv", {(PUMP, "rpm"): idle} | parked))
    assert contest.endswith("(too little motion to tell: chosen by name)")
