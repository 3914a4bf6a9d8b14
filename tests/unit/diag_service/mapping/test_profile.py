"""Profiles name sources for canonical signals; mistakes are reported together, units are checked by kind."""

import math
from pathlib import Path

import numpy as np
import pytest

from clutch_model.calibration import TorqueSource
from clutch_model.errors import CalibrationError
from diag_service.diagnosis.columns import BALANCE_SIGNALS, SLIP_SIGNALS, Signal
from diag_service.errors import ConfigError
from diag_service.mapping.profile import BusSource, find_profile, load_profile, shipped_profiles, to_si
from diag_service.mapping.vehicle_file import read_description


def write(folder: Path, text: str) -> Path:
    path = folder / "some.toml"
    path.write_text(text, encoding="utf-8")
    return path


def source(unit: str | None = None, scale: float = 1.0, offset: float = 0.0) -> BusSource:
    return BusSource(message="M", signal="S", unit=unit, scale=scale, offset=offset)


def converted(signal: Signal, unit: str | None, value: float, scale: float = 1.0, offset: float = 0.0) -> float:
    return float(to_si(signal, source(scale=scale, offset=offset), unit)(np.array([value]))[0])


def test_the_profile_of_our_database_has_a_source_for_every_signal_of_ours() -> None:
    profile = load_profile()
    assert profile.name == "dct"
    others = {Signal.INPUT_SPEED, Signal.CLUTCH_TORQUE, Signal.CLUTCH_SLIP, Signal.INJECTION_TIME}
    others |= {Signal.TURBINE_SPEED, Signal.LINE_PRESSURE_COMMAND, *SLIP_SIGNALS}  # of a torque converter
    others |= {Signal.ENGINE_TORQUE_COMMAND, Signal.SHIFT_ACTIVE, Signal.COOLANT_TEMPERATURE}  # of scan tools
    assert profile.sources.keys() == set(Signal) - others
    assert profile.sources.keys() >= set(BALANCE_SIGNALS)


def test_shipped_profiles_are_found_by_name() -> None:
    names = (
        "bmw_dkg",
        "dct",
        "dct_asked",
        "gm_t87a",
        "hyundai_dct",
        "j1939",
        "lockup",
        "vw_dsg",
        "vw_mqb",
        "vw_mqbevo",
        "vw_pq",
    )
    assert shipped_profiles() == names
    for name in shipped_profiles():
        profile = find_profile(Path(name))
        assert (profile.name, profile.is_lenient) == (name, True)
    assert find_profile(Path("j1939")).database is not None


@pytest.mark.parametrize(
    ("gears", "text"),
    [
        ("3", "must be a table"),
        ('{ over = "output_speed_rad_s" }', "gears.ratios is missing"),
        ('{ over = "pedal_ratio", ratios = [2.0, 1.0] }', "over must be"),
        ('{ over = "output_speed_rad_s", ratios = [1.0, 2.0] }', "must fall"),
        ('{ over = "output_speed_rad_s", ratios = [1.0, 0.0] }', "above 0"),
        ('{ over = "output_speed_rad_s", ratios = [inf, 1.0] }', "finite"),
        ('{ over = "output_speed_rad_s", ratios = ["a"] }', "list of numbers"),
    ],
)
def test_ratios_that_cannot_be_are_refused(tmp_path: Path, gears: str, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        load_profile(write(tmp_path, f"gears = {gears}\n[signals]\n"))
    with pytest.raises(CalibrationError, match=rf"some\.toml: .*{text}"):  # of a description of a vehicle
        read_description(write(tmp_path, f'like = "nominal"\ngears = {gears}\n'))


@pytest.mark.parametrize(
    ("signal", "unit", "value", "si"),
    [
        (Signal.ENGINE_SPEED, "rpm", 60.0, 2.0 * math.pi),
        (Signal.ENGINE_SPEED, "1/min", 60.0, 2.0 * math.pi),
        (Signal.ENGINE_SPEED, "Unit_MinutInver", 60.0, 2.0 * math.pi),
        (Signal.ENGINE_SPEED, "/min", 60.0, 2.0 * math.pi),
        (Signal.ENGINE_TORQUE, "ft-lb", 100.0, 135.5818),
        (Signal.ENGINE_TORQUE, "lb ft", 100.0, 135.5818),
        (Signal.CLUTCH1_PRESSURE, "psi", 100.0, 689_475.7),
        (Signal.SUMP_TEMPERATURE, "degF", 212.0, 373.15),
        (Signal.SUMP_TEMPERATURE, "°F", 32.0, 273.15),
        (Signal.VEHICLE_SPEED, "mph", 100.0, 44.704),
        (Signal.ENGINE_SPEED, "rad/s", 3.0, 3.0),
        (Signal.ENGINE_TORQUE, "N m", 3.0, 3.0),
        (Signal.CLUTCH1_PRESSURE, "bar", 2.0, 2e5),
        (Signal.CLUTCH1_PRESSURE, "kPa", 2.0, 2e3),
        (Signal.CLUTCH1_PRESSURE, "mbar", 2.0, 2e2),
        (Signal.CLUTCH1_PRESSURE, "Pa", 2.0, 2.0),
        (Signal.SUMP_TEMPERATURE, "degC", 20.0, 293.15),
        (Signal.SUMP_TEMPERATURE, "°C", 20.0, 293.15),
        (Signal.SUMP_TEMPERATURE, "K", 20.0, 20.0),
        (Signal.VEHICLE_SPEED, "km/h", 36.0, 10.0),
        (Signal.VEHICLE_SPEED, "m/s", 36.0, 36.0),
        (Signal.PEDAL, "%", 36.0, 0.36),
        (Signal.PEDAL, "", 0.36, 0.36),
        (Signal.PEDAL, None, 0.36, 0.36),
        (Signal.ODOMETER, "km", 1.5, 1500.0),
        (Signal.CURRENT_GEAR, None, 3.0, 3.0),
        (Signal.SHIFT_PHASE, "phase", 3.0, 3.0),
    ],
)
def test_units(signal: Signal, unit: str | None, value: float, si: float) -> None:
    assert converted(signal, unit, value) == pytest.approx(si, rel=1e-12)


@pytest.mark.parametrize(
    ("signal", "unit"),
    [(Signal.ENGINE_SPEED, "km/h"), (Signal.VEHICLE_SPEED, "knots"), (Signal.CLUTCH1_PRESSURE, None)],
)
def test_unit_of_another_kind_is_refused(signal: Signal, unit: str | None) -> None:
    with pytest.raises(ConfigError, match=f"is not one of {signal.value}"):
        to_si(signal, source(), unit)


def test_all_mistakes_are_reported_together(tmp_path: Path) -> None:
    text = """
[signals]
odometer_km = { message = "M", signal = "S" }
pedal_ratio = { message = "M" }
engine_torque_nm = { message = "M", signal = "S", gain = 2.0 }
hub_speed_rad_s = { message = "M", signal = 5 }
input1_speed_rad_s = { message = "M", signal = "S", scale = true }
input2_speed_rad_s = { message = "M", signal = "S", scale = 0.0 }
output_speed_rad_s = { message = "M", signal = "S", offset = nan }
current_gear = "M.S"
target_gear = { message = "M", pgn = 3, signal = "S" }
preselected_gear = { message = "M", signal = "S", valid = [3, 1] }
shift_phase = { message = "M", signal = "S", valid = [3] }
"""
    with pytest.raises(ConfigError) as refused:
        load_profile(write(tmp_path, text))
    complaints = str(refused.value)
    for complaint in (
        "odometer_km: not a canonical signal",
        "pedal_ratio: lacks signal",
        "engine_torque_nm: gain is unknown; known: check_codes, check_range, invalid",
        "hub_speed_rad_s: signal must be a string, got",
        "input1_speed_rad_s: scale must be a number, got",
        "input2_speed_rad_s: scale 0.0",
        "output_speed_rad_s: scale 1.0 and offset nan",
        "current_gear: must be a table",
        "target_gear: lacks message, or has it beside pgn",
        "preselected_gear: valid [3.0, 1.0] is no range",
        "shift_phase: valid must be a list of 2 numbers, got",
    ):
        assert complaint in complaints
    assert "\n" not in complaints


def test_a_profile_says_where_engine_torque_comes_from(tmp_path: Path) -> None:
    text = '[signals]\nengine_torque_nm = { column = "Fuel", unit = "Nm", scale = 40.0, origin = "without_cut" }'
    assert load_profile(write(tmp_path, text)).torque is TorqueSource.WITHOUT_CUT
    assert load_profile().torque is TorqueSource.MEASURED
    none = load_profile(write(tmp_path, '[signals]\nengine_speed_rad_s = { column = "Speed", unit = "rpm" }'))
    assert none.torque is TorqueSource.UNKNOWN
    with pytest.raises(ConfigError, match="engine_speed_rad_s: origin says where engine torque comes from"):
        load_profile(write(tmp_path, text.replace("engine_torque_nm", "engine_speed_rad_s")))
    with pytest.raises(ConfigError, match="origin must be one of measured, modelled, without_cut, unknown"):
        load_profile(write(tmp_path, text.replace("without_cut", "guessed")))
