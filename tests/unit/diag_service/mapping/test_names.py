"""Names that programs for owners of cars write, and what the units of their columns are read in."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.arrays import FloatArray
from canlog.database.signal_columns import SignalColumn, column_id, columns_database
from canlog.decode.signals import NO_INVALID, Decoded
from canlog.frames import EXTENDED_FLAG
from canlog.logs.signal_tables import frames_of_rows
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.mapped_messages import is_of_lockup, missing_for_next, reach_in_words, tier_of
from diag_service.mapping.names import named_signal, read_name
from diag_service.mapping.profile import profile_of
from diag_service.mapping.proposal import Candidate, SignalStatistics, candidates, profile_text, questioned, unfit_units
from diag_service.mapping.units import USUAL, conversion, told_step

NAMES = {
    "HP Tuners": {
        "Engine RPM (SAE)": Signal.ENGINE_SPEED,
        "Trans Turbine RPM": Signal.TURBINE_SPEED,
        "Trans Output Shaft RPM": Signal.OUTPUT_SPEED,
        "TCC Slip": Signal.LOCKUP_SLIP,
        "TCC Desired Slip": Signal.LOCKUP_SLIP_COMMAND,
        "TCC Line Pressure": Signal.LOCKUP_PRESSURE_COMMAND,
        "Engine Torque (SAE)": Signal.ENGINE_TORQUE,
        "Commanded Engine Torque": Signal.ENGINE_TORQUE_COMMAND,
        "Trans Current Gear": Signal.CURRENT_GEAR,
        "Trans Commanded Gear": Signal.TARGET_GEAR,
        "Trans Fluid Temp": Signal.SUMP_TEMPERATURE,
        "Engine Coolant Temp (SAE)": Signal.COOLANT_TEMPERATURE,
        "Vehicle Speed (SAE)": Signal.VEHICLE_SPEED,
    },
    "FORScan": {
        "TSS_SRC": Signal.TURBINE_SPEED,
        "OSS_SRC": Signal.OUTPUT_SPEED,
        "TCC_SLIP": Signal.LOCKUP_SLIP,
        "TCC_PRES": Signal.LOCKUP_PRESSURE_COMMAND,
        "LINEDSD": Signal.LINE_PRESSURE_COMMAND,
        "TFT": Signal.SUMP_TEMPERATURE,
    },
    "VCDS": {
        "Clutch 1: pressure": Signal.CLUTCH1_PRESSURE,
        "Speed of input shaft 2": Signal.INPUT2_SPEED,
        "Transmission oil temperature": Signal.SUMP_TEMPERATURE,
    },
    "SimosTools": {"RPM": Signal.ENGINE_SPEED, "DSG Clutch 2 Pressure": Signal.CLUTCH2_PRESSURE},
    "Torque": {
        "Engine RPM(rpm)": Signal.ENGINE_SPEED,
        "Speed (OBD)(km/h)": Signal.VEHICLE_SPEED,
        "Transmission Temperature(Method 1)(°C)": Signal.SUMP_TEMPERATURE,
    },
    "OBD Fusion": {"Torque converter clutch slip speed (RPM)": Signal.LOCKUP_SLIP},
    "Car Scanner": {"Transmission input shaft speed": Signal.INPUT_SPEED, "Torque Converter Slip": Signal.LOCKUP_SLIP},
    "EcuTek": {
        "Clutch A Pressure": Signal.CLUTCH1_PRESSURE,
        "Clutch B Desired Pressure": Signal.CLUTCH2_PRESSURE_COMMAND,
    },
    "scripts": {
        "turbine_rpm": Signal.TURBINE_SPEED,
        "tcc_desired_slip_rpm": Signal.LOCKUP_SLIP_COMMAND,
        "immediate_engine_torque_cmd_nm": Signal.ENGINE_TORQUE_COMMAND,
        "trans_gear_actual": Signal.CURRENT_GEAR,
        "TransFluidTemp": Signal.SUMP_TEMPERATURE,
        "shift_in_progress": Signal.SHIFT_ACTIVE,
        "TCC actual pressure": Signal.LOCKUP_PRESSURE,
    },
}


@pytest.mark.parametrize(("program", "name"), [(program, name) for program, names in NAMES.items() for name in names])
def test_names_of_programs_are_quantities(program: str, name: str) -> None:
    assert named_signal(name) is NAMES[program][name]


@pytest.mark.parametrize(
    "name",
    [
        "trans_slip_rpm",
        "Brake Pressure",
        "Boost Pressure",
        "pcs1_cmd_pressure",
        "Engine Oil Temp",
        "Intake Air Temp",
        "",
    ],
)
def test_other_names_are_none(name: str) -> None:
    assert named_signal(name) is None


@settings(max_examples=200, deadline=None)
@given(name=st.text(max_size=40))
def test_any_text_is_a_name(name: str) -> None:
    assert named_signal(name) in {None, *Signal}
    assert read_name(name).unit in {"", *(unit for units in USUAL.values() for unit in units), "mbar"}


@pytest.mark.parametrize(
    ("name", "unit"), [("tcc_slip_rpm", "rpm"), ("oil_temp_f", "degF"), ("Engine Torque Nm", "Nm"), ("TCC Slip", "")]
)
def test_a_unit_may_end_a_name(name: str, unit: str) -> None:
    assert read_name(name).unit == unit


def column(name: str, values: FloatArray, unit: str = "") -> SignalStatistics:
    found = SignalStatistics(message=name, signal=name, unit=unit, is_column=True)
    found.add(Decoded(np.asarray(values, np.float64), None, NO_INVALID, None))
    return found


def proposed(*columns: SignalStatistics) -> dict[Signal, Candidate]:
    return {signal: found[0] for signal, found in candidates(columns).items()}


KM_H, CELSIUS, NM = np.arange(0.0, 100.0), np.arange(50.0, 62.0), 0.5 * np.arange(-100.0, 700.0)


@pytest.mark.parametrize(
    ("kind", "told", "unit", "own"),
    [
        ("m_s", KM_H / 1.609344, "mph", "1 km/h"),
        ("k", 32.0 + 1.8 * CELSIUS, "degF", "1 degC"),
        ("nm", NM / 1.355818, "lb·ft", "0.5 Nm"),
        ("pa", 0.0625 * np.arange(0.0, 6000.0) / 6.894757, "psi", "0.0625 kPa"),
    ],
)
def test_steps_of_a_controller_show_in_which_unit_values_are_told(
    kind: str, told: FloatArray, unit: str, own: str
) -> None:
    step = told_step(np.round(told, 10)[:4096].astype(np.float64), kind)
    assert step is not None
    assert (step.unit, step.native) == (unit, own)


@settings(max_examples=50, deadline=None)
@given(
    step=st.sampled_from([1.0, 0.5, 0.1, 0.25, 0.125, 2.0]),
    count=st.integers(10, 500),
    kind=st.sampled_from(["m_s", "k", "nm", "pa", "rad_s"]),
)
def test_round_steps_and_no_steps_show_nothing(step: float, count: int, kind: str) -> None:
    assert told_step(step * np.arange(count, dtype=np.float64), kind) is None
    assert told_step(np.sort(np.random.default_rng(count).uniform(0.0, 100.0, count)).astype(np.float64), kind) is None


def test_a_name_that_its_steps_contradict_has_both_readings() -> None:
    best = candidates([column("trans_fluid_temp_c", 32.0 + 1.8 * CELSIUS)])
    reading = best[Signal.SUMP_TEMPERATURE][0].reading
    assert (reading.unit, reading.other) == ("degF", "degC")
    text = profile_text("car", best, [])
    assert 'sump_temperature_k = { column = "trans_fluid_temp_c", unit = "degF", or_unit = "degC" }' in text
    assert "# questioned: the name says degC, but its steps of 1.8 are 1 degC told in degF" in text
    assert '# or: sump_temperature_k = { column = "trans_fluid_temp_c", unit = "degC" }' in text


@pytest.mark.parametrize("coolant", [True, False])
def test_oil_that_is_too_hot_is_questioned(*, coolant: bool) -> None:
    oil = np.linspace(110.0 if coolant else 122.3, 142.0, 37)
    others = [column("Engine Coolant Temp", np.linspace(85.0, 90.0, 30), "°C")] if coolant else []
    by_name = proposed(column("trans_fluid_temp_c", oil), *others)[Signal.SUMP_TEMPERATURE].reading
    assert (by_name.unit, by_name.other) == ("degF", "degC")
    by_header = proposed(column("Trans Fluid Temp", oil, "°C"), *others)[Signal.SUMP_TEMPERATURE].reading
    assert (by_header.unit, by_header.other) == ("°C", "degF")  # whoever wrote a unit meant it
    assert "but it would" in by_header.why


def test_speed_is_questioned_by_that_of_the_output_shaft() -> None:
    output = column("Output Shaft RPM", np.linspace(0.0, 2000.0, 500))
    speed = np.linspace(0.0, 27.2, 333)  # m/s: .13 m for a radian
    assert proposed(column("Vehicle Speed", speed), output)[Signal.VEHICLE_SPEED].unit == "m/s"
    assert proposed(column("Vehicle Speed", 3.6 * speed), output)[Signal.VEHICLE_SPEED].unit == "km/h"


def test_columns_of_one_country_are_read_alike() -> None:
    oil = np.linspace(60.3, 96.1, 77)
    assert proposed(column("Trans Fluid Temp", oil))[Signal.SUMP_TEMPERATURE].unit == "degC"
    speed = column("Vehicle Speed", np.linspace(0.0, 50.3, 99), "mph")
    assert proposed(column("Trans Fluid Temp", oil), speed)[Signal.SUMP_TEMPERATURE].unit == "degF"


def test_torques_that_would_agree_in_one_unit_are_told() -> None:
    torque = NM / 1.355818
    best = candidates(
        [column("trans_engine_torque_nm", torque), column("delivered_engine_torque_nm", torque[::7] + 0.01)]
    )
    assert best[Signal.ENGINE_TORQUE][0].reading.unit == "lb·ft"
    by_steps, by_other = questioned(best)
    assert by_steps.endswith("told in lb·ft. It is read in lb·ft")
    assert by_other.endswith("would agree in one unit")


def test_the_input_of_a_gearbox_behind_a_converter_is_the_turbine() -> None:
    speed = column("Transmission input shaft speed", np.linspace(700.0, 4000.0, 100), "rpm")
    assert proposed(speed).keys() == {Signal.INPUT_SPEED}
    slip = column("TCC slip", np.linspace(0.0, 100.0, 50), "rpm")
    assert proposed(speed, slip).keys() == {Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP}


def test_a_multiple_of_a_unit_is_one() -> None:
    convert = conversion("pa", "0.1 kPa")
    assert convert is not None
    assert convert(np.array([1013.0])).tolist() == pytest.approx([101_300.0])
    assert conversion("pa", "0.1 rpm") is None


SPELLINGS = [
    ("pa", "MPa", 1e6), ("pa", "kgf/cm2", 98066.5), ("pa", "kgf/cm²", 98066.5), ("pa", "kg/cmÂ²", 98066.5),
    ("pa", "atm", 101_325.0),
    ("rad_s", "tr/min", np.pi / 30.0), ("rad_s", "min^-1", np.pi / 30.0), ("m_s", "km/hr", 1.0 / 3.6),
    ("nm", "NÂ·m", 1.0),
    ("nm", "kgf·m", 9.80665), ("nm", "lbf ft", 1.355818),
    *(("k", unit, 274.15) for unit in ("Â°C", ".C", "ºC", "\ufffdC", "deg. C", "ï¿½C")),
    *(("k", unit, 255.9277777777778) for unit in ("Â°F", ".F", "\ufffdF")),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "unit", "value"), SPELLINGS)
def test_units_are_known_in_many_spellings(kind: str, unit: str, value: float) -> None:
    convert = conversion(kind, unit)
    assert convert is not None
    assert convert(np.array([1.0])).tolist() == pytest.approx([value])


def test_a_unit_that_nobody_knows_is_told() -> None:
    statistics = [
        column("Engine RPM", np.linspace(800.0, 3000.0, 100), "furlongs"),
        column("Gear", np.arange(1.0, 6.0)),
    ]
    (sentence,) = unfit_units(statistics, candidates(statistics))
    assert "Engine RPM" in sentence
    assert "furlongs" in sentence


COMMANDED = frozenset({Signal.LOCKUP_SLIP, Signal.TURBINE_SPEED, Signal.LOCKUP_PRESSURE_COMMAND, Signal.ENGINE_TORQUE})
MEASURED = COMMANDED - {Signal.LOCKUP_PRESSURE_COMMAND} | {Signal.LOCKUP_PRESSURE, Signal.ENGINE_SPEED}


@pytest.mark.parametrize(
    ("signals", "reach"),
    [
        (MEASURED, "tier 1 (friction of the lock-up clutch)"),
        (COMMANDED, "tier 2 (slope of friction of the lock-up clutch over slip, no level)"),
        (COMMANDED - {Signal.ENGINE_TORQUE}, "tier 3 (slip and shudder of the lock-up clutch)"),
        ({Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.LOCKUP_PRESSURE_COMMAND}, "tier 3 (slip and shudder"),
        ({Signal.LOCKUP_PRESSURE_COMMAND, Signal.ENGINE_TORQUE}, "no tier"),
    ],
)
def test_tiers_of_a_lockup_clutch_are_told_before_the_drive(signals: frozenset[Signal], reach: str) -> None:
    assert is_of_lockup(signals)
    assert reach_in_words(signals).startswith(reach)
    assert (tier_of(signals, has_converter=True) is None) == (reach == "no tier")


def test_a_commanded_pressure_is_told_to_be_none() -> None:
    missing = missing_for_next(COMMANDED, has_converter=True)
    assert missing.startswith("friction of the lock-up clutch needs lock-up pressure as measured:")
    assert missing_for_next(MEASURED, has_converter=True) == ""
    assert missing_for_next(COMMANDED - {Signal.ENGINE_TORQUE}, has_converter=True) == (
        "slope of friction of the lock-up clutch over slip needs engine torque"
    )


def test_engine_speed_is_turbine_speed_plus_slip() -> None:
    t_us = 30_000.0 * np.arange(40, dtype=np.float64)
    names = ["Engine RPM", "Trans Turbine RPM", "TCC Slip"]
    turbine, slip = 1500.0 + 5.0 * np.arange(40), np.linspace(0.0, 39.0, 40)
    values = np.column_stack([np.where(np.arange(40) % 20 == 0, 9.0, np.nan), turbine, slip])
    values[::2, 1] = np.nan  # each at its own rate
    ids = np.array([column_id(name) | EXTENDED_FLAG for name in names], np.uint32)
    best = candidates(
        [column(name, values[:, place][np.isfinite(values[:, place])]) for place, name in enumerate(names)]
    )
    text = profile_text("car", best, [])
    assert "# or: engine_speed_rad_s = " in text
    profile = profile_of(tomllib.loads(text), Path("car.toml"))
    assert Signal.ENGINE_SPEED not in profile.sources
    for size in (40, 7):  # the same however the rows come
        decoder = Decoder(columns_database([SignalColumn(name, "rpm") for name in names]), profile)
        assert Signal.ENGINE_SPEED in decoder.signals
        batches = [frames_of_rows(t_us[n : n + size], values[n : n + size], ids) for n in range(0, 40, size)]
        parts = [one.columns[Signal.ENGINE_SPEED] for batch in batches for one in decoder.feed(batch)]
        engine_rpm = np.concatenate([part.value for part in parts]) / (np.pi / 30.0)
        assert np.abs(engine_rpm - turbine - slip).max() <= 5.01  # one row of the turbine's, at an end
        assert Signal.ENGINE_SPEED in decoder.seen
