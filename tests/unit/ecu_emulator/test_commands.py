"""What the command line names overrides the scenario."""

from pathlib import Path

import pytest

from clutchdiag_io.command_line import record_of
from ecu_emulator.cli import command_line
from ecu_emulator.commands import DriveOptions, choose_scenario
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario import Scenario


def chosen(*words: str) -> Scenario:
    context = command_line.commands["record"].make_context("record", ["x.log", *words])
    return choose_scenario(record_of(DriveOptions, context.params))


def test_the_shift_cycle_is_driven_unless_something_else_is_named() -> None:
    scenario = chosen()
    assert (scenario.drive, scenario.endless, scenario.is_on_the_road) == (DriveName.CYCLE, False, False)
    assert scenario.truth.plant == {}


@pytest.mark.parametrize(
    ("oil_degc", "coolant_degc", "air_degc"), [("-10", -10.0, -10.0), ("40", 40.0, 20.0), ("95", 80.0, 20.0)]
)
def test_a_car_with_cold_oil_has_stood_in_the_cold(oil_degc: str, coolant_degc: float, air_degc: float) -> None:
    ambient = chosen("--drive", "wltc", "--oil-degc", oil_degc).ambient
    assert ambient.oil_temperature_k - 273.15 == pytest.approx(float(oil_degc))
    assert ambient.coolant_temperature_k - 273.15 == pytest.approx(coolant_degc)
    assert ambient.temperature_k - 273.15 == pytest.approx(air_degc)


def test_a_mass_is_a_truth_of_the_vehicle_beside_others(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('name = "own"\n[truth.plant]\nvehicle.drag_area_m2 = 0.6\nvehicle.mass_kg = 1500\n')
    scenario = chosen("--scenario", str(path), "--mass-kg", "2100")
    assert scenario.truth.plant == {"vehicle.drag_area_m2": 0.6, "vehicle.mass_kg": 2100.0}


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ('drive = "nedc"', "drive must be one of cycle, wltc, udds, hwfet, us06, city, day, got 'nedc'"),
        ('drive = "wltc"\n[routine]\nopen_revs = 2', "not with drive wltc"),
    ],
)
def test_a_drive_that_cannot_be_is_named_in_one_line(tmp_path: Path, line: str, named: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(f'name = "own"\n{line}\n')
    with pytest.raises(EmulatorConfigError, match=named):
        chosen("--scenario", str(path))
