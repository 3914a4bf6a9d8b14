"""What the monitors say of a sound drive, and of each fault that they are there for."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice

import pytest

from dbc.contract import load_contract
from ecu_emulator.bus.frames import EncodedFrames, merge
from ecu_emulator.bus.sent_values import SentValues
from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.monitors import NOMINAL_LIMITS, MonitorLimits, Watch, is_warm, judge
from ecu_emulator.diagnostics.table_file import shipped_table, table_like, table_of
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.scenario.faults import Cause, CauseKind, SensorFault, SensorFaultKind
from ecu_emulator.scenario.scenario import Ambient, Fluid, FluidCondition, Truth
from ecu_emulator.scenario.scenario_file import load_scenario
from tests.support.road import road_scenario

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
    watch, said = Watch(), dict[str, TestResult]()
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


FOURTH = HOLDING | {
    "current_gear": 4.0, "target_gear": 4.0, "clutch2_pressure_pa": 8e5, "clutch2_pressure_command_pa": 8e5,
    "clutch1_pressure_pa": 0.2e5, "clutch1_pressure_command_pa": 0.1e5, "input2_speed_rad_s": 107.9,
    "hub_speed_rad_s": 107.9, "engine_speed_rad_s": 107.9, "clutch1_slip_rad_s": 40.0, "clutch2_slip_rad_s": 0.0,
}  # fmt: skip


def changing(clutch: int, change: Callable[[float], float], looks: int = 12) -> list[dict[str, float]]:
    """Return gears 3, 4, 3 and 4 as they are held, with something done to the pressure of one clutch."""
    name = f"clutch{clutch}_pressure_pa"
    return [held | {name: change(held[name])} for held in (HOLDING, FOURTH) * 2 for _ in range(looks)]


@pytest.mark.parametrize("clutch", [1, 2])
@pytest.mark.parametrize("bias_pa", [-8e5, -0.7e5, 1.6e5, 8e5])
def test_a_biased_sensor_is_called_by_its_name_and_silences_what_depends_on_it(clutch: int, bias_pa: float) -> None:
    def biased(pressure_pa: float) -> float:
        return max(pressure_pa + bias_pa, -1e5)

    said = {1: "P0841", 2: "P0846"}[clutch]
    assert failing(*changing(clutch, biased)) == {said}
    assert failing(*changing(clutch, biased)[6:]) == {said}  # whenever it begins


@pytest.mark.parametrize("clutch", [1, 2])
@pytest.mark.parametrize(
    ("codes", "low_pa", "high_pa"),
    [
        (("P0868", "P0868"), 0.2e5, 5e5),
        (("P0746", "P0776"), 0.2e5, 1e5),  # none of it: the solenoid does nothing
        (("P0747", "P0777"), 3e5, 8e5),  # never without
    ],
)
def test_a_pressure_that_is_wrong_with_a_right_sensor_has_a_code_of_its_own(
    clutch: int, codes: tuple[str, str], low_pa: float, high_pa: float
) -> None:
    moments = changing(clutch, lambda pressure_pa: high_pa if pressure_pa > 4e5 else low_pa)
    assert failing(*moments) == failing(*moments[6:]) == {codes[clutch - 1]}


def test_a_pressure_that_was_wrong_for_a_moment_only_is_not_believed() -> None:
    moments = changing(1, lambda pressure_pa: pressure_pa)
    moments[10:12] = [moments[10] | {"clutch1_pressure_pa": 5e5}] * 2
    assert failing(*moments) == set()


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("sump_temperature_k", "P0711"),
        ("clutch1_pressure_pa", "P0841"),
        ("clutch2_pressure_pa", "P0846"),
        ("hub_speed_rad_s", "P0715"),
        ("input1_speed_rad_s", "P0715"),
        ("input2_speed_rad_s", "P0715"),
    ],
)
def test_a_sensor_that_says_nothing_fails_its_own_code(name: str, code: str) -> None:
    silent = {key: value for key, value in HOLDING.items() if key != name}
    assert failing(silent, silent) == {code}


def test_fluid_that_stays_as_it_was_while_the_engine_warms_up_has_a_frozen_sensor() -> None:
    def warming(fluid_k: float) -> list[dict[str, float]]:
        return [
            HOLDING | {"coolant_temperature_k": 290.0 + step, "sump_temperature_k": 290.0 + fluid_k * step}
            for step in range(45)
        ]

    assert failing(*warming(0.0)) == {"P0711"}
    assert failing(*warming(0.02)) == {"P0711"}
    assert failing(*warming(0.1)) == set()
    assert failing(*warming(0.0)[:29]) == set()  # it may still be too early


def test_a_temperature_that_jumps_is_the_sensors_and_says_nothing_of_heat() -> None:
    assert failing(HOLDING, HOLDING | {"sump_temperature_k": 395.0}) == {"P0711"}


def test_a_wrong_ratio_names_its_own_gear() -> None:
    limits = MonitorLimits(input_output_ratios=(4.780, 2.933, 2.153, 1.678, 1.390, 1.203, 1.0))
    for gear, code in ((6, "P0729"), (7, "P076F")):
        held = HOLDING | {"current_gear": gear, "target_gear": gear, "output_speed_rad_s": 120.0}
        shaft = "input1" if gear == 7 else "input2"
        watch, _ = judge(Watch(), held, 100.0, limits)
        _, samples = judge(
            watch, held | {f"{shaft}_speed_rad_s": 1.04 * 120.0 * (1.203 if gear == 6 else 1.0)}, 101.0, limits
        )
        assert {said for said, result in samples if said[:3] == "P07" and result is TestResult.PREFAILED} == {code}


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
    low = HOLDING | {"clutch1_pressure_command_pa": 1e5}
    assert not {"P0868", "P0746"} & set(verdicts(*[low] * 12))


def test_a_warm_engine_makes_a_warm_up_cycle() -> None:
    cold = Watch(start_coolant_k=300.0)
    assert not is_warm(cold, {})
    assert not is_warm(cold, {"coolant_temperature_k": 340.0})
    assert is_warm(cold, {"coolant_temperature_k": 350.0})
    assert not is_warm(Watch(start_coolant_k=340.0), {"coolant_temperature_k": 360.0})  # by 20 K only
    assert not is_warm(Watch(), {"coolant_temperature_k": 360.0})


def test_a_cycle_counts_once_it_was_driven_fast_and_slow_for_long_enough() -> None:
    idling = {"engine_speed_rad_s": 85.0, "vehicle_speed_m_s": 0.0, "pedal_ratio": 0.0}
    fast = {"engine_speed_rad_s": 200.0, "vehicle_speed_m_s": 12.0, "pedal_ratio": 0.3}

    def driven(*parts: tuple[dict[str, float], int]) -> bool:
        watch, t_s = Watch(), 0.0
        for values, duration_s in parts:
            for _ in range(duration_s):
                watch, _ = judge(watch, values, t_s)
                t_s += 1.0
        return watch.driven.is_enough

    assert driven((fast, 310), (idling, 31), (fast, 270))
    assert not driven((fast, 310), (idling, 31), (fast, 240))  # not yet ten minutes
    assert not driven((fast, 290), (idling, 330))  # not fast for long enough
    assert not driven((fast, 310), (idling, 20), (fast, 270), (idling, 20))  # never idle for long enough
    assert not driven((idling | {"engine_speed_rad_s": 0.0}, 700))


def test_every_code_that_a_monitor_says_is_in_the_table() -> None:
    known = {trouble.code for trouble in shipped_table().troubles.values()}
    for gear in range(1, 7):
        assert set(verdicts(*[HOLDING | {"current_gear": gear, "target_gear": gear}] * 2)) <= known


def driven(fluid: str, *faults: SensorFault) -> Iterator[dict[str, float]]:
    """Yield what the controller senses ten times a second on a drive."""
    scenario = replace(load_scenario(fluid), cycles=1, sensor_faults=faults)
    frames, _ = frames_of(scenario)
    yield from sensed(frames)


def sensed(frames: EncodedFrames, transmission: str = "nominal") -> Iterator[dict[str, float]]:
    values, next_s = SentValues(load_contract(transmission)), STEP_S
    for t_s, can_id, data in zip(frames.t_s.tolist(), frames.can_id.tolist(), frames.data, strict=True):
        if t_s >= next_s:
            next_s += STEP_S
            yield dict(values.now({}))
        values.note(can_id, data.tobytes())


def failed_on_drive(fluid: str, *faults: SensorFault) -> dict[str, int]:
    return failures(driven(fluid, *faults))


def failures(moments: Iterable[dict[str, float]], limits: MonitorLimits = NOMINAL_LIMITS) -> dict[str, int]:
    """Return how often each code that was tested failed."""
    watch, count = Watch(), dict[str, int]()
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
        "P0811",
        "P0218",
        "P2787",
        "P0711",
        "P0841",
        "P0868",
        "P0746",
        "P0747",
        "P0776",
        "P0777",
        "P0715",
        "P0716",
        "P0780",
        "P0731",
        "P0735",
        "P0729",
    }
    assert {code: failures for code, failures in count.items() if failures} == {}


def test_launches_creeps_and_stops_of_a_sound_car_fail_nothing() -> None:
    ambient = Ambient(temperature_k=273.15, oil_temperature_k=273.15, coolant_temperature_k=273.15)
    drive = Drive(replace(road_scenario("ideal"), ambient=ambient))
    stretches = islice(drive.stretches(10.0), 24)
    count = failures(sensed(merge([stretch.frames for stretch in stretches])))
    assert set(count) >= {"P0811", "P0868", "P0777", "P0780", "P0731", "P0732", "P0716"}
    assert {code: number for code, number in count.items() if number} == {}


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


@pytest.mark.parametrize(("clutch", "size_pa", "start_s"), [(1, -3e5, 0.0), (2, 2e5, 5.0), (1, 6e5, 3.0)])
def test_a_biased_sensor_fails_no_other_code_on_a_drive_whenever_it_begins(
    clutch: int, size_pa: float, start_s: float
) -> None:
    fault = SensorFault(
        quantity=f"clutch{clutch}_pressure_pa", kind=SensorFaultKind.OFFSET, size=size_pa, start_s=start_s
    )
    count = failed_on_drive("ideal", fault)
    assert {code for code, number in count.items() if number} == {{1: "P0841", 2: "P0846"}[clutch]}


def test_a_pump_that_no_longer_reaches_its_pressure_is_no_matter_of_sensors() -> None:
    weak = (Cause(kind=CauseKind.WEAK_PUMP, strength=4.0),)
    scenario = replace(load_scenario("ideal"), cycles=1, seed=2, causes=weak)
    count = failures(sensed(frames_of(scenario)[0]))
    assert count["P0868"] >= 10
    assert not any(count.get(code) for code in ("P0841", "P0846", "P0746", "P0776", "P0747", "P0777"))


@pytest.mark.parametrize("seed", [11, 12])
def test_sound_vehicles_of_any_seed_fail_nothing(seed: int) -> None:
    count = failures(sensed(frames_of(replace(load_scenario("ideal"), cycles=1, seed=seed))[0]))
    assert {code: number for code, number in count.items() if number} == {}


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


def test_a_lock_up_clutch_without_friction_slips_too_much() -> None:
    assert failed_with_converter(mu=0.02)["P0741"] > 50


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


def test_an_open_converter_that_does_not_slip_is_stuck_on() -> None:
    known = {"lockup_state": 0.0, "lockup_slip_rad_s": 0.2, "engine_torque_nm": 80.0, "current_gear": 3.0}
    assert failures([known] * 20, CONVERTER_LIMITS)["P0742"] > 5
    assert failures([known | {"lockup_slip_rad_s": 12.0}] * 20, CONVERTER_LIMITS)["P0742"] == 0


def test_the_controller_of_an_automatic_has_its_codes_beside_the_shared_ones() -> None:
    own, shared = ({one.code for one in table.troubles.values()} for table in (table_of("lockup"), shipped_table()))
    assert own - shared == {"P0741", "P0742", "P2757", "P2758"}
    assert table_of("gs7") is shipped_table()
    alike = table_like("vw_dsg", "lockup")
    assert {one.code for one in alike.troubles.values()} == own
    assert {*alike.data} == {*table_of("lockup").data, *table_like("vw_dsg").data}
    assert {one.name for one in table_of("lockup").data.values()} >= {
        "speed of the turbine",
        "slip of the lock-up clutch",
    }
