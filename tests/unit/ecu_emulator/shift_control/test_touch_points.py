"""Touch points found by pressure steps of the plant, with the noise of its sensors; and fills that use them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isnan

import numpy as np
import pytest

from clutch_model.calibration import Calibration, clutch_of_gear, nominal_calibration
from ecu_emulator.plant import Col, DriveSettings, Powertrain, nominal_parameters
from ecu_emulator.shift_control import tcu_data
from ecu_emulator.shift_control.touch_points import (
    FINE_PA,
    Felt,
    Finding,
    PressureSteps,
    Result,
    Sample,
    Search,
    TouchPoint,
    are_over,
    finding_of,
    nominal_touch_pressures_pa,
    sample_of,
)
from tests.support.cycles import CYCLE_SHIFTS, FloatArray, shifts

NOMINAL_PA = nominal_touch_pressures_pa()
LIMIT_PA = 0.25e5
MARGIN_PA = nominal_parameters().control.touch_margin_pa


def truth(*offsets_pa: float) -> Calibration:
    """Return a car whose touch points are so much above those of the type."""
    nominal = nominal_calibration()
    first, second = (
        replace(
            clutch,
            piston=replace(
                clutch.piston,
                spring_preload_n=clutch.piston.spring_preload_n + offset_pa * clutch.geometry.piston_area_m2,
            ),
        )
        for clutch, offset_pa in zip(nominal.clutches, offsets_pa, strict=True)
    )
    return replace(nominal, clutches=(first, second))


def sensed(rows: FloatArray, clutch: int, rng: np.random.Generator) -> list[Sample]:
    """Return what the controller's sensors say a hundred times a second, in the steps of the bus."""
    rows = rows[::10]
    torque_nm = np.round(rows[:, Col.ENGINE_TORQUE] + rng.normal(0.0, 3.0, len(rows)))
    speed_rad_s = rows[:, Col.ENGINE_SPEED] + rng.normal(0.0, 0.21, len(rows))
    columns = (
        rows[:, Col.T_S], np.round(rows[:, Col.PRESSURE1_COMMAND + clutch - 1], -3), torque_nm, speed_rad_s,
        rows[:, Col.INPUT1_SPEED + clutch - 1],
    )  # fmt: skip
    return [
        Sample(t_s=t, command_pa=command, engine_torque_nm=torque, engine_speed_rad_s=speed, shaft_speed_rad_s=shaft)
        for t, command, torque, speed, shaft in zip(*(column.tolist() for column in columns), strict=True)
    ]


@dataclass
class Shop:
    """A car in a workshop and who adapts its clutches."""

    car: Powertrain
    rng: np.random.Generator

    def hold(self, steps: PressureSteps) -> FloatArray:
        self.car.begin_steps(steps)
        rows = [self.car.advance(0.25)]
        while not self.car.is_waiting:
            rows.append(self.car.advance(0.25))
        return np.concatenate([*rows, self.car.advance(0.25)])

    def search(self, clutch: int) -> tuple[Result, TouchPoint | None]:
        search = Search(clutch=clutch, nominal_pa=NOMINAL_PA[clutch - 1], most_change_pa=LIMIT_PA)
        while (steps := search.next_steps()) is not None:
            samples = sensed(self.hold(steps), clutch, self.rng)
            assert are_over(samples)
            search = search.after(finding_of(samples, steps))
        return search.ended()


def shop(*offsets_pa: float, oil_k: float = 353.15) -> Shop:
    settings = DriveSettings(waits=True, initial_oil_k=oil_k)
    car = Powertrain(truth(*offsets_pa), nominal_parameters(), settings, touch_pressures_pa=NOMINAL_PA)
    car.advance(5.0)
    return Shop(car=car, rng=np.random.default_rng(1))


@pytest.mark.parametrize(
    ("offsets_pa", "oil_k"),
    [((-7_300.0, 12_600.0), 323.15), ((1_900.0, -23_800.0), 373.15)],
)
def test_drawn_touch_points_are_found_within_the_stated_deviation(
    offsets_pa: tuple[float, float], oil_k: float
) -> None:
    car = shop(*offsets_pa, oil_k=oil_k)
    for clutch, offset_pa in enumerate(offsets_pa, start=1):
        result, found = car.search(clutch)
        assert result is Result.FOUND
        assert found is not None
        assert found.std_pa < 1_500.0  # less than a third of how far touch points scatter
        assert abs(found.pressure_pa - NOMINAL_PA[clutch - 1] - offset_pa) < 2.0 * found.std_pa


def test_the_car_stands_and_its_engine_runs_meanwhile() -> None:
    car = shop(-20_000.0, 0.0)
    steps = Search(clutch=1, nominal_pa=NOMINAL_PA[0], most_change_pa=LIMIT_PA).next_steps()
    assert steps is not None
    rows = car.hold(steps)
    assert np.abs(rows[:, [Col.VEHICLE_SPEED, Col.WHEEL_SPEED]]).max() < 1e-3  # the driveline lets go at the end
    assert rows[:, Col.ENGINE_SPEED].min() > 30.0
    assert not rows[:, [Col.CURRENT_GEAR, Col.TARGET_GEAR]].any()
    assert set(rows[:, Col.SHAFT1_GEAR]) == {0.0, 5.0}
    assert not rows[:, [Col.SHAFT2_GEAR, Col.PRESSURE2_COMMAND]].any()
    assert rows[-1, [Col.SHAFT1_GEAR, Col.PRESSURE1_COMMAND]].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("offset_pa", [60_000.0, -33_000.0])
def test_a_touch_point_beyond_what_may_be_adapted_is_held_at_the_limit(offset_pa: float) -> None:
    result, found = shop(offset_pa, 0.0).search(1)
    bound_pa = NOMINAL_PA[0] + (LIMIT_PA if offset_pa > 0.0 else -LIMIT_PA)
    assert result is Result.AT_LIMIT
    assert found is not None
    assert (found.pressure_pa, found.is_at_limit, isnan(found.std_pa)) == (bound_pa, True, True)


def test_steps_that_are_broken_off_leave_the_car_waiting() -> None:
    car = shop(0.0, 0.0).car
    car.begin_steps(PressureSteps(clutch=2, top_pa=1.6e5, down_pa=1e4, count=9))
    car.advance(3.0)
    car.begin_steps(PressureSteps(clutch=1, top_pa=1.6e5, down_pa=1e4, count=9))  # one at a time
    car.stop_steps()
    rows = car.advance(2.0)
    assert car.is_waiting
    assert not rows[-1, [Col.SHAFT1_GEAR, Col.SHAFT2_GEAR, Col.PRESSURE1_COMMAND, Col.PRESSURE2_COMMAND]].any()


# --- from steps to a touch point


STEPS = PressureSteps(clutch=1, top_pa=1.44e5, down_pa=FINE_PA, count=9)


def told(loads_nm: Sequence[float], *, shaft_rad_s: float = 0.0, left_out: int | None = None) -> list[Sample]:
    """Return what sensors without noise say of steps in which the clutch carries so much."""
    commands = [(0.0, 1.0, 0.0), (7e5, 0.2, 0.0), (STEPS.top_pa + 0.2e5, 0.5, 20.0)]
    commands += [(STEPS.pressure_pa(step), 0.8, load) for step, load in enumerate(loads_nm) if step != left_out]
    samples: list[Sample] = []
    for command_pa, duration_s, torque_nm in [*commands, (0.0, 0.5, 0.0)]:
        for _ in range(round(duration_s * 100)):
            t_s = 7.0 + 0.01 * len(samples)
            samples.append(
                Sample(
                    t_s=t_s, command_pa=round(command_pa, -3), engine_torque_nm=torque_nm - 2.0,
                    engine_speed_rad_s=75.0, shaft_speed_rad_s=shaft_rad_s,
                )
            )  # fmt: skip
    return samples


@pytest.mark.parametrize(
    ("loads_nm", "felt", "pressure_pa"),
    [
        ([9, 8, 7, 6, 0, 0, 0, 0, 0], Felt.BETWEEN, 1.37e5),
        ([9, 8, 1.0, 6, 5, 0, 0, 0, 0], Felt.BETWEEN, 1.35e5),  # one that is not felt between others is noise
        ([9, 8, 7, 0, 0, 0, 2, 0, 0], Felt.BETWEEN, 1.39e5),  # likewise
        ([0] * 9, Felt.NEVER, None),
        ([12, 11, 10, 9, 8, 7, 6, 5, 4], Felt.ALWAYS, None),
    ],
)
def test_the_touch_point_lies_between_what_is_felt_and_what_is_not(
    loads_nm: list[float], felt: Felt, pressure_pa: float | None
) -> None:
    found = finding_of(told(loads_nm), STEPS)
    assert found.felt is felt
    assert pressure_pa is None or found.pressure_pa == pytest.approx(pressure_pa)


def test_a_shaft_that_turns_or_a_sensor_that_is_silent_says_nothing() -> None:
    loads_nm = [9, 8, 7, 6, 0, 0, 0, 0, 0]
    assert finding_of(told(loads_nm, shaft_rad_s=9.0), STEPS).felt is Felt.UNCLEAR
    assert finding_of(told(loads_nm, left_out=6), STEPS).felt is Felt.UNCLEAR
    assert finding_of([], STEPS).felt is Felt.UNCLEAR
    known = {"engine_torque_nm": 1.0, "engine_speed_rad_s": 75.0, "input1_speed_rad_s": 0.0}
    assert sample_of(known, 1.0, 1) is None
    for left_out in ("", *known):
        values = {name: value for name, value in known.items() if name != left_out}
        sample = sample_of({**values, "clutch1_pressure_command_pa": 0.0}, 1.0, 1)
        assert sample is not None
        assert sample.is_known is not bool(left_out)
    assert not are_over([])
    assert not are_over(told(loads_nm)[:300])


def ended(*fine: Finding, coarse: Felt = Felt.BETWEEN) -> Result:
    start = Search(clutch=1, nominal_pa=1.4e5, most_change_pa=LIMIT_PA)
    search = start.after(Finding(felt=coarse, pressure_pa=1.4e5))
    for one in fine:
        assert search.next_steps() is not None
        search = search.after(one)
    assert search.next_steps() is None
    return search.ended()[0]


def test_a_search_that_scatters_or_sees_nothing_adapts_nothing() -> None:
    good, far = (Finding(felt=Felt.BETWEEN, pressure_pa=pressure_pa) for pressure_pa in (1.4e5, 1.47e5))
    unclear = Finding(felt=Felt.UNCLEAR)
    assert ended(good, good, good) is Result.FOUND
    assert ended(good, unclear, good, good) is Result.FOUND
    assert ended(good, far, good) is Result.SCATTERS
    assert ended(unclear, good, unclear, good, unclear) is Result.UNCLEAR
    assert ended(coarse=Felt.UNCLEAR) is Result.UNCLEAR
    assert ended(coarse=Felt.NEVER) is Result.AT_LIMIT
    assert ended(*[Finding(felt=Felt.BETWEEN, pressure_pa=1.1e5)] * 3) is Result.AT_LIMIT
    assert Search(clutch=1, nominal_pa=1.4e5, most_change_pa=LIMIT_PA).ended() == (Result.UNCLEAR, None)


# --- what fills make of it


def driven(believed_pa: tuple[float, float], offsets_pa: tuple[float, float]) -> FloatArray:
    """Return a cycle by a control that believes in these touch points."""
    car = Powertrain(truth(*offsets_pa), nominal_parameters(), DriveSettings(), touch_pressures_pa=NOMINAL_PA)
    car.believe(believed_pa)
    return car.advance(60.0)


def fill_errors_pa(rows: FloatArray, offsets_pa: tuple[float, float]) -> list[float]:
    """Return how far from the margin above the true touch point each on-coming clutch is held once it is filled."""
    is_fill = rows[:, Col.SHIFT_PHASE] == tcu_data.PREFILL
    ends = rows[np.flatnonzero(is_fill[:-1] & ~is_fill[1:])]
    errors = []
    for row in ends:
        place = clutch_of_gear(int(row[Col.TARGET_GEAR])) - 1
        held_pa = row[Col.PRESSURE1_COMMAND + place] - NOMINAL_PA[place] - offsets_pa[place]
        errors.append(float(held_pa - MARGIN_PA))
    return errors


def test_fills_are_off_until_a_clutch_is_adapted_and_it_shifts_all_the_same() -> None:
    offset_pa = 5_000.0
    offsets_pa = (offset_pa, -offset_pa)
    before = driven(NOMINAL_PA, offsets_pa)
    found_pa = (NOMINAL_PA[0] + offset_pa + 600.0, NOMINAL_PA[1] - offset_pa - 600.0)
    after = driven(found_pa, offsets_pa)
    assert shifts(before) == shifts(after) == CYCLE_SHIFTS
    errors = [fill_errors_pa(rows, offsets_pa) for rows in (before, after)]
    assert [abs(error) for error in errors[0]] == pytest.approx([abs(offset_pa)] * 10)
    assert [abs(error) for error in errors[1]] == pytest.approx([600.0] * 10)
    for rows in (before, after):
        is_held = (rows[:, Col.SHIFT_PHASE] == 0.0) & (rows[:, Col.T_S] > 1.0)
        shaft = np.where(rows[:, Col.CURRENT_GEAR] % 2 == 1.0, rows[:, Col.INPUT1_SPEED], rows[:, Col.INPUT2_SPEED])
        assert np.abs(rows[:, Col.HUB_SPEED] - shaft)[is_held].max() < 10.0


def test_a_control_that_knows_its_clutches_drives_as_one_that_was_told() -> None:
    offsets_pa = (4_000.0, 3_000.0)
    car, parameters = truth(*offsets_pa), nominal_parameters()
    touch_pa = (car.clutches[0].touch_pressure_pa, car.clutches[1].touch_pressure_pa)
    known = Powertrain(car, parameters, DriveSettings())
    informed = Powertrain(car, parameters, DriveSettings(), touch_pressures_pa=touch_pa)
    assert np.array_equal(known.advance(5.0), informed.advance(5.0))
