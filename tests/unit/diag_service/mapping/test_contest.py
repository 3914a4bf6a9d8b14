"""Candidates for a quantity compete on the data: physics decides where they differ, else the name, and that is said."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.contest import Contest, Sureness, joined, judged, thinned
from diag_service.mapping.proposal import Candidate, SignalStatistics
from diag_service.mapping.units import UnitReading

STEP_S = 0.05
ROWS = 6000
RATIOS: FloatArray = np.array([4.0, 2.4, 1.5, 1.0])
RNG_SEED = 3

Columns = Mapping[Signal, Sequence[tuple[str, FloatArray]]]


def converter_car() -> dict[Signal, FloatArray]:
    """Return a drive with a torque converter: gears of 12 s, slip that fades in each, torque that drives it."""
    rng = np.random.default_rng(RNG_SEED)
    t_s = np.asarray(STEP_S * np.arange(ROWS), np.float64)
    gear = 1 + (t_s // 12.0).astype(np.int64) % 4
    swing = np.asarray(np.sin(2.0 * np.pi * t_s / 12.0), np.float64)
    turbine_rad_s = 220.0 + 90.0 * swing + rng.normal(0.0, 0.4, ROWS)
    slip_rad_s = 40.0 * np.exp(-(t_s % 12.0) / 2.0)
    gain = np.gradient(220.0 + 90.0 * swing, STEP_S)
    pressure_pa = 4e5 + 3e5 * np.asarray(np.sign(np.sin(t_s / 1.7)), np.float64)
    measured_pa = pressure_pa.copy()
    for row in range(1, ROWS):
        measured_pa[row] = measured_pa[row - 1] + STEP_S / 0.2 * (pressure_pa[row] - measured_pa[row - 1])
    return {
        Signal.ENGINE_SPEED: turbine_rad_s + slip_rad_s,
        Signal.TURBINE_SPEED: turbine_rad_s,
        Signal.LOCKUP_SLIP: slip_rad_s,
        Signal.OUTPUT_SPEED: turbine_rad_s / RATIOS[gear - 1],
        Signal.CURRENT_GEAR: gear.astype(np.float64),
        Signal.ENGINE_TORQUE: 80.0 + 1.3 * gain + rng.normal(0.0, 3.0, ROWS),
        Signal.LOCKUP_PRESSURE: measured_pa,
        Signal.LOCKUP_PRESSURE_COMMAND: pressure_pa,
        Signal.SUMP_TEMPERATURE: 350.0 + 0.01 * t_s,
    }


def series(value: FloatArray) -> Series:
    t_ns = np.rint(1e9 * STEP_S * np.arange(len(value))).astype(np.int64)
    return Series(t_ns=t_ns, sequence=np.full(len(value), -1), value=value)


def held(columns: Columns) -> tuple[dict[Signal, str], dict[Signal, Contest]]:
    """Return which column physics chose for each quantity, and the contests."""
    best = {
        signal: [
            Candidate(
                signal=signal,
                statistics=SignalStatistics(message=name, signal=name, unit="", is_column=True),
                reading=UnitReading(unit=""),
                score=6.0,
            )
            for name, _ in named
        ]
        for signal, named in columns.items()
    }
    tracks = {
        (signal, rank): series(value) for signal, named in columns.items() for rank, (_, value) in enumerate(named)
    }
    ordered, contests = judged(best, tracks)
    chosen = {signal: candidates[0].statistics.place for signal, candidates in ordered.items()}
    return chosen, {contest.signal: contest for contest in contests}


def of_car(car: Mapping[Signal, FloatArray], *signals: Signal) -> dict[Signal, list[tuple[str, FloatArray]]]:
    return {signal: [(signal.value, car[signal])] for signal in signals}


SLIP = (Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP)


@pytest.mark.parametrize("is_first", [True, False])
def test_the_turbine_is_what_engine_less_slip_is(is_first: bool) -> None:
    car = converter_car()
    columns = of_car(car, *SLIP)
    columns[Signal.TURBINE_SPEED].insert(0 if is_first else 1, ("pump", car[Signal.ENGINE_SPEED] + 0.1))
    chosen, contests = held(columns)
    contest = contests[Signal.TURBINE_SPEED]
    assert (chosen[Signal.TURBINE_SPEED], contest.sureness) == (Signal.TURBINE_SPEED.value, Sureness.SURE)
    assert contest.places == (Signal.TURBINE_SPEED.value, "pump")
    assert contest.misfits[0] < 0.1
    assert contest.misfits[1] > 50.0
    assert "engine less turbine speed against slip: 'turbine_speed_rad_s' " in contest.text
    assert contest.text.endswith("; chosen: 'turbine_speed_rad_s' (sure)")


def test_without_slip_the_turbine_is_what_turns_by_the_ratio_of_the_gear() -> None:
    car = converter_car()
    columns = of_car(car, Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.OUTPUT_SPEED, Signal.CURRENT_GEAR)
    columns[Signal.TURBINE_SPEED].insert(0, ("pump", car[Signal.ENGINE_SPEED]))
    chosen, contests = held(columns)
    assert chosen[Signal.TURBINE_SPEED] == Signal.TURBINE_SPEED.value
    assert contests[Signal.TURBINE_SPEED].sureness in {Sureness.SURE, Sureness.LIKELY}


def test_the_gear_is_what_the_ratio_changes_with() -> None:
    car = converter_car()
    columns = of_car(car, Signal.TURBINE_SPEED, Signal.OUTPUT_SPEED, Signal.CURRENT_GEAR)
    columns[Signal.CURRENT_GEAR].insert(0, ("selector", np.full(ROWS, 4.0)))
    chosen, contests = held(columns)
    assert (chosen[Signal.CURRENT_GEAR], contests[Signal.CURRENT_GEAR].sureness) == (
        Signal.CURRENT_GEAR.value,
        Sureness.SURE,
    )


def test_the_torque_is_what_the_engine_gains_speed_by() -> None:
    car, rng = converter_car(), np.random.default_rng(1)
    columns = of_car(car, Signal.ENGINE_SPEED, Signal.CURRENT_GEAR, Signal.ENGINE_TORQUE)
    brake = -car[Signal.ENGINE_TORQUE] + rng.normal(0.0, 3.0, ROWS)
    columns[Signal.ENGINE_TORQUE].insert(0, ("brake", brake))
    chosen, contests = held(columns)
    assert chosen[Signal.ENGINE_TORQUE] == Signal.ENGINE_TORQUE.value
    assert contests[Signal.ENGINE_TORQUE].sureness in {Sureness.SURE, Sureness.LIKELY}


def test_the_measured_pressure_is_what_follows() -> None:
    car = converter_car()
    columns = of_car(car, Signal.LOCKUP_PRESSURE)
    columns[Signal.LOCKUP_PRESSURE].insert(0, ("asked", car[Signal.LOCKUP_PRESSURE_COMMAND]))
    chosen, contests = held(columns)
    assert (chosen[Signal.LOCKUP_PRESSURE], contests[Signal.LOCKUP_PRESSURE].sureness) == (
        Signal.LOCKUP_PRESSURE.value,
        Sureness.SURE,
    )


def test_of_nearly_equal_ones_the_name_chooses_and_it_is_said() -> None:
    car, rng = converter_car(), np.random.default_rng(2)
    columns = of_car(car, *SLIP)
    noise = (rng.normal(0.0, 6.0, ROWS) for _ in range(2))
    columns[Signal.TURBINE_SPEED] = [(name, car[Signal.TURBINE_SPEED] + next(noise)) for name in ("first", "second")]
    chosen, contests = held(columns)
    assert (chosen[Signal.TURBINE_SPEED], contests[Signal.TURBINE_SPEED].sureness) == ("first", Sureness.EQUAL)
    assert "nearly equal on this log: chosen by name" in contests[Signal.TURBINE_SPEED].text


def test_in_a_standing_car_there_is_too_little_motion_to_tell() -> None:
    still = dict.fromkeys(SLIP, np.full(ROWS, 80.0)) | {Signal.LOCKUP_SLIP: np.zeros(ROWS)}
    columns = of_car(still, *SLIP)
    columns[Signal.TURBINE_SPEED].insert(0, ("pump", np.full(ROWS, 80.2)))
    chosen, contests = held(columns)
    assert (chosen[Signal.TURBINE_SPEED], contests[Signal.TURBINE_SPEED].sureness) == ("pump", Sureness.TOO_LITTLE)
    assert contests[Signal.TURBINE_SPEED].misfits == ()


def test_temperatures_are_told_apart_by_name_only() -> None:
    car = converter_car()
    columns = of_car(car, Signal.SUMP_TEMPERATURE, *SLIP)
    columns[Signal.SUMP_TEMPERATURE].append(("coolant", car[Signal.SUMP_TEMPERATURE] + 20.0))
    chosen, contests = held(columns)
    assert (chosen[Signal.SUMP_TEMPERATURE], contests[Signal.SUMP_TEMPERATURE].sureness) == (
        Signal.SUMP_TEMPERATURE.value,
        Sureness.BY_NAME,
    )


def test_a_lone_turbine_that_is_the_engine_once_more_is_taken_for_none() -> None:
    car = converter_car()
    columns = of_car(car, *SLIP)
    columns[Signal.TURBINE_SPEED] = [("pump", car[Signal.ENGINE_SPEED] + 0.1)]
    chosen, contests = held(columns)
    assert Signal.TURBINE_SPEED not in chosen
    assert contests[Signal.TURBINE_SPEED].text.endswith("rpm (none fits)")
    assert held(of_car(car, *SLIP))[1] == {}


def test_a_short_moment_of_difference_decides_nothing() -> None:
    car = converter_car()
    columns = of_car(car, *SLIP)
    other = car[Signal.TURBINE_SPEED].copy()
    other[300:320] += 50.0
    columns[Signal.TURBINE_SPEED].insert(0, ("once", other))
    chosen, contests = held(columns)
    assert (chosen[Signal.TURBINE_SPEED], contests[Signal.TURBINE_SPEED].sureness) == ("once", Sureness.TOO_LITTLE)


def test_a_thinned_signal_has_one_sample_a_cell_and_pieces_come_in_order() -> None:
    t_ns = np.arange(0, 10**9, 10**6, dtype=np.int64)
    fast = Series(t_ns=t_ns, sequence=np.full(len(t_ns), -1), value=np.asarray(t_ns * 1e-9, np.float64))
    thin = thinned(fast)
    assert len(thin.t_ns) == 20
    assert np.diff(thin.t_ns).min() >= 0.049e9
    halves = [thin.between(5 * 10**8, 10**9), thin.between(0, 5 * 10**8)]
    assert joined(halves).t_ns.tolist() == thin.t_ns.tolist()
