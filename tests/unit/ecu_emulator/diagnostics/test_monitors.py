"""What the monitors say of a sound drive, and of each fault that they are there for."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice

import pytest

from dbc.contract import load_contract
from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.monitors import Watch, is_warm, judge
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.faults import SensorFault, SensorFaultKind
from ecu_emulator.frames import EncodedFrames, merge
from ecu_emulator.recording import Drive, frames_of
from ecu_emulator.scenario import Ambient
from ecu_emulator.scenario_file import load_scenario
from ecu_emulator.sent_values import SentValues
from tests.support.road import road_scenario

STEP_S = 0.1
HOLDING = {
    "current_gear": 3.0, "target_gear": 3.0, "shift_phase": 0.0, "engine_torque_nm": 150.0, "sump_temperature_k": 350.0,
    "clutch1_slip_rad_s": 0.5, "clutch2_slip_rad_s": 40.0, "clutch1_pressure_pa": 8e5,
    "clutch1_pressure_command_pa": 8e5,
    "clutch2_pressure_pa": 0.2e5, "clutch2_pressure_command_pa": 0.1e5, "input1_speed_rad_s": 146.4,
    "output_speed_rad_s": 100.0,
}  # fmt: skip


def verdicts(*moments: dict[str, float], step_s: float = 1.0) -> dict[str, TestResult]:
    """Return the last word of every monitor after these moments, a second apart."""
    watch, said = Watch(), dict[str, TestResult]()
    for number, values in enumerate(moments):
        watch, samples = judge(watch, values, 100.0 + number * step_s)
        said |= dict(samples)
    return said


def failing(*moments: dict[str, float]) -> set[str]:
    return {code for code, result in verdicts(*moments).items() if result is TestResult.PREFAILED}


def test_a_gear_that_is_held_soundly_passes() -> None:
    said = verdicts(HOLDING, HOLDING)
    assert set(said) == {"P0711", "P0218", "P0841", "P0780", "P0811", "P0868", "P0776", "P0733", "P2787"}
    assert set(said.values()) == {TestResult.PREPASSED}


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("P0811", {"clutch1_slip_rad_s": 15.0}),
        ("P0811", {"clutch1_slip_rad_s": -15.0}),
        ("P0218", {"sump_temperature_k": 395.0}),
        ("P0711", {"sump_temperature_k": 500.0}),
        ("P0841", {"clutch2_pressure_pa": 36e5}),
        ("P0841", {"clutch1_pressure_pa": -0.9e5, "clutch1_pressure_command_pa": 0.0}),
        ("P0868", {"clutch1_pressure_pa": 5e5}),
        ("P0776", {"clutch2_pressure_pa": 3e5}),
        ("P0733", {"input1_speed_rad_s": 152.0}),
    ],
)
def test_each_fault_fails_its_own_code(code: str, change: dict[str, float]) -> None:
    faulty = HOLDING | change
    assert failing(faulty, faulty) == {code}


@pytest.mark.parametrize("name", ["sump_temperature_k", "clutch1_pressure_pa"])
def test_a_sensor_that_says_nothing_fails_its_own_code(name: str) -> None:
    silent = {key: value for key, value in HOLDING.items() if key != name}
    assert failing(silent, silent) == {"P0711" if name == "sump_temperature_k" else "P0841"}


def test_a_temperature_that_jumps_is_the_sensors_and_says_nothing_of_heat() -> None:
    assert failing(HOLDING, HOLDING | {"sump_temperature_k": 395.0}) == {"P0711"}


def test_a_shift_that_never_ends_fails() -> None:
    shifting = HOLDING | {"target_gear": 4.0, "shift_phase": 2.0}
    assert failing(shifting, shifting, shifting) == set()
    assert failing(*[shifting] * 5) == {"P0780"}


def test_nothing_is_said_of_clutches_where_it_cannot_be_known() -> None:
    slipping = HOLDING | {"clutch1_slip_rad_s": 50.0}
    assert "P0811" not in verdicts(slipping)  # the gear is not settled
    assert "P0811" not in verdicts(*[slipping | {"engine_torque_nm": 10.0}] * 2)
    assert "P0811" not in verdicts(*[slipping | {"target_gear": 4.0}] * 2)
    assert "P0733" not in verdicts(*[HOLDING | {"output_speed_rad_s": 2.0}] * 2)
    assert "P0868" not in verdicts(*[HOLDING | {"clutch1_pressure_command_pa": 1e5}] * 2)


def test_a_warm_engine_makes_a_warm_up_cycle() -> None:
    assert not is_warm({})
    assert not is_warm({"coolant_temperature_k": 340.0})
    assert is_warm({"coolant_temperature_k": 350.0})


def test_every_code_that_a_monitor_says_is_in_the_table() -> None:
    known = {trouble.code for trouble in shipped_table().troubles.values()}
    for gear in range(1, 7):
        assert set(verdicts(*[HOLDING | {"current_gear": gear, "target_gear": gear}] * 2)) <= known


def driven(fluid: str, *faults: SensorFault) -> Iterator[dict[str, float]]:
    """Yield what the controller senses ten times a second on a drive."""
    scenario = replace(load_scenario(fluid), cycles=1, sensor_faults=faults)
    frames, _ = frames_of(scenario)
    yield from sensed(frames)


def sensed(frames: EncodedFrames) -> Iterator[dict[str, float]]:
    values, next_s = SentValues(load_contract()), STEP_S
    for t_s, can_id, data in zip(frames.t_s.tolist(), frames.can_id.tolist(), frames.data, strict=True):
        if t_s >= next_s:
            next_s += STEP_S
            yield dict(values.now({}))
        values.note(can_id, data.tobytes())


def failed_on_drive(fluid: str, *faults: SensorFault) -> dict[str, int]:
    return failures(driven(fluid, *faults))


def failures(moments: Iterable[dict[str, float]]) -> dict[str, int]:
    """Return how often each code that was tested failed."""
    watch, count = Watch(), dict[str, int]()
    for number, values in enumerate(moments):
        watch, samples = judge(watch, values, number * STEP_S)
        if number < 5:
            continue  # not all messages have been sent
        for code, result in samples:
            count[code] = count.get(code, 0) + (result is TestResult.PREFAILED)
    return count


@pytest.mark.parametrize("fluid", ["ideal", "case2"])
def test_a_sound_drive_fails_nothing_and_tests_every_gear(fluid: str) -> None:
    count = failed_on_drive(fluid)
    assert set(count) >= {
        "P0811",
        "P0218",
        "P2787",
        "P0711",
        "P0841",
        "P0868",
        "P0776",
        "P0780",
        "P0731",
        "P0735",
        "P0729",
    }
    assert {code: failures for code, failures in count.items() if failures} == {}


@pytest.mark.parametrize("oil_k", [273.15, 363.15])
def test_launches_creeps_and_stops_of_a_sound_car_fail_nothing(oil_k: float) -> None:
    ambient = Ambient(temperature_k=273.15, oil_temperature_k=oil_k, coolant_temperature_k=min(oil_k, 353.15))
    drive = Drive(replace(road_scenario("ideal"), ambient=ambient))
    stretches = islice(drive.stretches(10.0), 24)
    count = failures(sensed(merge([stretch.frames for stretch in stretches])))
    assert set(count) >= {"P0811", "P0868", "P0776", "P0780", "P0731", "P0732"}
    assert {code: number for code, number in count.items() if number} == {}


@pytest.mark.parametrize(
    ("quantity", "kind", "size", "code"),
    [
        ("sump_temperature_k", SensorFaultKind.NOT_AVAILABLE, 0.0, "P0711"),
        ("clutch1_pressure_pa", SensorFaultKind.NOT_AVAILABLE, 0.0, "P0841"),
        ("clutch2_pressure_pa", SensorFaultKind.OFFSET, 3e5, "P0776"),
        ("hub_speed_rad_s", SensorFaultKind.OFFSET, 25.0, "P0811"),
        ("output_speed_rad_s", SensorFaultKind.OFFSET, 15.0, "P0732"),
    ],
)
def test_a_fault_of_a_drive_is_found(quantity: str, kind: SensorFaultKind, size: float, code: str) -> None:
    assert failed_on_drive("ideal", SensorFault(quantity=quantity, kind=kind, size=size, start_s=5.0))[code] >= 5
