"""What the monitors say of a sound drive, and of each fault that they are there for."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest

from dbc.contract import load_contract
from ecu_emulator.bus.frames import EncodedFrames, merge
from ecu_emulator.bus.sent_values import SentValues
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.scenario.faults import SensorFault, SensorFaultKind
from ecu_emulator.scenario.scenario import Fluid, FluidCondition, Truth
from ecu_emulator.scenario.scenario_file import load_scenario
from workshop.controller.memory import TestResult
from workshop.controller.monitors import NOMINAL_LIMITS, MonitorLimits, MonitorState, judge

STEP_S = 0.1
HOLDING = {
    "current_gear": 3.0, "target_gear": 3.0, "shift_phase": 0.0, "engine_torque_nm": 150.0, "sump_temperature_k": 350.0,
    "clutch1_slip_rad_s": 0.5, "clutch2_slip_rad_s": 40.0, "clutch1_pressure_pa": 8e5,
    "clutch1_pressure_command_pa": 8e5,
    "clutch2_pressure_pa": 0.2e5, "clutch2_pressure_command_pa": 0.1e5, "input1_speed_rad_s": 146.4,
    "input2_speed_rad_s": 106.0, "hub_speed_rad_s": 146.4, "engine_speed_rad_s": 146.4,
    "is_silent_ECM": 0.0, "is_silent_ABS": 0.0, "is_silent_IC": 0.0,
    "output_speed_rad_s": 100.0,
}  # fmt: skip


def verdicts(*moments: dict[str, float], step_s: float = 1.0) -> dict[str, TestResult]:
    """Return the last word of every monitor after these moments, a second apart."""
    watch, said = MonitorState(), dict[str, TestResult]()
    for number, values in enumerate(moments):
        watch, samples = judge(watch, values, 100.0 + number * step_s)
        said |= dict(samples)
    return said


def failing(*moments: dict[str, float]) -> set[str]:
    return {code for code, result in verdicts(*moments).items() if result is TestResult.PREFAILED}


def test_a_gear_that_is_held_soundly_passes() -> None:
    said = verdicts(HOLDING, HOLDING)
    assert set(said) == {
        "P0711", "P0218", "P0841", "P0846", "P0780", "P0811", "P0868", "P0746", "P0777", "P0733", "P2787", "P0715",
        "P0716", "U0100", "U0121", "U0155",
    }  # fmt: skip
    assert set(said.values()) == {TestResult.PREPASSED}


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("P0811", {"clutch1_slip_rad_s": 15.0}),
        ("P0811", {"clutch1_slip_rad_s": -15.0}),
        ("P0218", {"sump_temperature_k": 395.0}),
        ("P0711", {"sump_temperature_k": 500.0}),
        ("P0846", {"clutch2_pressure_pa": 36e5}),
        ("P0841", {"clutch1_pressure_pa": 36e5}),
        ("P0841", {"clutch1_pressure_pa": -0.9e5, "clutch1_pressure_command_pa": 0.0}),
        ("P0733", {"input1_speed_rad_s": 152.0}),
        ("P0716", {"input1_speed_rad_s": 170.0, "clutch1_slip_rad_s": -23.6}),  # hub and output say something else
        ("P0716", {"hub_speed_rad_s": 170.0, "clutch1_slip_rad_s": 23.6}),  # so do engine and shaft
        ("U0100", {"is_silent_ECM": 1.0}),
        ("U0121", {"is_silent_ABS": 1.0}),
        ("U0155", {"is_silent_IC": 1.0}),
    ],
)
def test_each_fault_fails_its_own_code(code: str, change: dict[str, float]) -> None:
    faulty = HOLDING | change
    assert failing(faulty, faulty) == {code}


def driven(fluid: str, *faults: SensorFault) -> Iterator[dict[str, float]]:
    """Yield what the controller senses ten times a second on a drive."""
    scenario = replace(load_scenario(fluid), cycles=1, sensor_faults=faults)
    frames, _ = frames_of(scenario)
    yield from sensed(frames)


def sensed(frames: EncodedFrames, transmission: str = "nominal") -> Iterator[dict[str, float]]:
    values, looks_s = SentValues(load_contract(transmission)), np.arange(0.0, frames.t_s[-1], STEP_S)
    for first, end in pairwise(np.searchsorted(frames.t_s, looks_s)):
        latest = dict(zip(frames.can_id[first:end].tolist(), frames.data[first:end], strict=True))
        for can_id, data in latest.items():
            values.note(can_id, data.tobytes())
        yield values.now({})


def failed_on_drive(fluid: str, *faults: SensorFault) -> dict[str, int]:
    return failures(driven(fluid, *faults))


def failures(moments: Iterable[dict[str, float]], limits: MonitorLimits = NOMINAL_LIMITS) -> dict[str, int]:
    """Return how often each code that was tested failed."""
    watch, count = MonitorState(), dict[str, int]()
    for number, values in enumerate(moments):
        watch, samples = judge(watch, values, number * STEP_S, limits)
        if number < 5:
            continue  # not all messages have been sent
        for code, result in samples:
            count[code] = count.get(code, 0) + (result is TestResult.PREFAILED)
    return count


@pytest.mark.parametrize("fluid", ["ideal", "case2"])
def test_a_sound_drive_fails_nothing_and_tests_every_gear(fluid: str) -> None:
    count = failed_on_drive(fluid)
    assert set(count) >= {
        "P0811", "P0218", "P2787", "P0711", "P0841", "P0868", "P0746", "P0747", "P0776", "P0777", "P0715", "P0716",
        "P0780", "P0731", "P0735", "P0729",
    }  # fmt: skip
    assert {code: failures for code, failures in count.items() if failures} == {}


@pytest.mark.parametrize(
    ("quantity", "kind", "size", "code"),
    [
        ("sump_temperature_k", SensorFaultKind.NOT_AVAILABLE, 0.0, "P0711"),
        ("clutch1_pressure_pa", SensorFaultKind.NOT_AVAILABLE, 0.0, "P0841"),
        ("input2_speed_rad_s", SensorFaultKind.NOT_AVAILABLE, 0.0, "P0715"),
        ("input1_speed_rad_s", SensorFaultKind.OFFSET, 25.0, "P0716"),
        ("output_speed_rad_s", SensorFaultKind.OFFSET, 15.0, "P0732"),
    ],
)
def test_a_fault_of_a_drive_is_found(quantity: str, kind: SensorFaultKind, size: float, code: str) -> None:
    assert failed_on_drive("ideal", SensorFault(quantity=quantity, kind=kind, size=size, start_s=5.0))[code] >= 5


def test_a_pressure_sensor_that_reads_too_low_is_not_called_low_line_pressure() -> None:
    biased = SensorFault(quantity="clutch2_pressure_pa", kind=SensorFaultKind.OFFSET, size=-3e5, start_s=5.0)
    failed = {code for code, count in failed_on_drive("ideal", biased).items() if count}
    assert failed & {"P0841", "P0846", "P0868"} == {"P0846"}


CONVERTER_LIMITS = MonitorLimits(
    has_converter=True, input_output_ratios=nominal_parameters("lockup").gearbox.input_output_ratios
)


def failed_with_converter(
    *faults: SensorFault, fluid: FluidCondition = FluidCondition.IDEAL, mu: float | None = None, length_s: float = 110.0
) -> dict[str, int]:
    """Return how often each code failed in the beginning of an automatic's drive."""
    friction = {} if mu is None else {"clutch1.friction.mu_c": mu, "clutch1.friction.mu_s": mu}
    scenario = replace(
        load_scenario("lockup"), sensor_faults=faults, fluid=Fluid(condition=fluid), truth=Truth(calibration=friction)
    )
    stretches = islice(Drive(scenario).stretches(10.0), round(length_s / 10.0))
    return failures(sensed(merge([one.frames for one in stretches]), "lockup"), CONVERTER_LIMITS)


def test_a_sound_automatic_fails_nothing_even_where_it_shudders() -> None:
    count = failed_with_converter(fluid=FluidCondition.CASE_2, length_s=260.0)
    assert set(count) >= {"P0741", "P0742", "P2757", "P2758", "P0841", "P0715", "P0731", "P0735", "P0780", "P0711"}
    assert not {"P0811", "P0746", "P0846", "P2787"} & set(count)
    assert {code: number for code, number in count.items() if number} == {}


@pytest.mark.parametrize(
    ("quantity", "kind", "size", "code"),
    [
        ("lockup_pressure_pa", SensorFaultKind.OFFSET, -3e5, "P0841"),
        ("lockup_pressure_pa", SensorFaultKind.FROZEN, 0.0, "P2757"),
        ("turbine_speed_rad_s", SensorFaultKind.NOT_AVAILABLE, 0.0, "P0715"),
        ("turbine_speed_rad_s", SensorFaultKind.OFFSET, 40.0, "P0741"),
        ("output_speed_rad_s", SensorFaultKind.OFFSET, 15.0, "P0735"),
    ],
)
def test_a_fault_of_an_automatics_drive_is_found(quantity: str, kind: SensorFaultKind, size: float, code: str) -> None:
    assert failed_with_converter(SensorFault(quantity=quantity, kind=kind, size=size, start_s=5.0))[code] >= 5
