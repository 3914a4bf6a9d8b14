"""A signal is absent only if it stands still where physics demands motion: by closed clutches, and changes of gear."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.mapping.liveness import LEAST_LIVE, LEAST_RECORDED, Liveness

RATIOS: FloatArray = np.array([16.0, 9.6, 6.1, 4.4])
PERIOD_S = 0.02
GEAR_S = 4.0  # in which a gear is driven from 60 to 95 % of its highest speed, and back
CHANGE_S = 0.4
SEED = 5

Values = dict[Signal, FloatArray]


def driven(*gears: int, noise: float = 0.003) -> Values:
    """Return the signals of a drive through some gears, whose clutch slips while they change."""
    rng, pieces = np.random.default_rng(SEED), list[FloatArray]()
    for number, gear in enumerate(gears):
        count = int(GEAR_S / PERIOD_S)
        swing = 0.775 - 0.175 * np.cos(2.0 * np.pi * np.arange(count) / count)
        engine_rad_s = 400.0 * swing
        ratio = np.full(count, RATIOS[gear - 1])
        if number:
            leaving = np.linspace(RATIOS[gears[number - 1] - 1] / RATIOS[gear - 1], 1.0, int(CHANGE_S / PERIOD_S))
            ratio[: len(leaving)] *= leaving
        pieces.append(np.array([engine_rad_s, engine_rad_s / ratio, np.full(count, float(gear))]))
    engine_rad_s, output_rad_s, gear_number = np.concatenate(pieces, axis=1)
    engine_rad_s = engine_rad_s * (1.0 + noise * rng.standard_normal(len(engine_rad_s)))
    is_odd = gear_number % 2 == 1
    return {
        Signal.ENGINE_SPEED: engine_rad_s,
        Signal.ENGINE_TORQUE: 60.0 + 40.0 * np.gradient(engine_rad_s),
        Signal.INPUT_SPEED: engine_rad_s,
        Signal.INPUT1_SPEED: np.where(is_odd, engine_rad_s, 0.6 * engine_rad_s),
        Signal.INPUT2_SPEED: np.where(is_odd, 0.6 * engine_rad_s, engine_rad_s),
        Signal.OUTPUT_SPEED: output_rad_s,
        Signal.CURRENT_GEAR: gear_number,
        Signal.TARGET_GEAR: gear_number,
        Signal.SUMP_TEMPERATURE: np.full(len(gear_number), 353.0),
        Signal.DRIVE_STATE: np.zeros(len(gear_number)),
        Signal.VEHICLE_SPEED: 0.1 * output_rad_s,
    }


def standing() -> Values:
    """Return the signals of a car that stands with its engine revved up now and then."""
    count = 4000
    engine_rad_s = np.asarray(90.0 + 150.0 * (np.sin(np.arange(count) / 300.0) > 0.3), np.float64)
    still: Values = dict.fromkeys(driven(1), np.zeros(count))
    return still | {Signal.ENGINE_SPEED: engine_rad_s, Signal.ENGINE_TORQUE: 10.0 + 0.1 * engine_rad_s}


def batch_of(values: Mapping[Signal, FloatArray], first: int, stop: int, *, breaks: bool = False) -> ColumnBatch:
    t_ns = np.rint(1e9 * PERIOD_S * np.arange(first, stop)).astype(np.int64)
    columns = {
        signal: Series(t_ns=t_ns, sequence=np.full(len(t_ns), -1), value=value[first:stop])
        for signal, value in values.items()
    }
    return ColumnBatch(columns=columns, watermark_ns=int(t_ns[-1]), breaks_before=breaks)


def heard(values: Mapping[Signal, FloatArray], step: int = 10_000, state: Liveness | None = None) -> Liveness:
    state = state or Liveness.of(values.keys())
    count = len(values[Signal.ENGINE_SPEED])
    for first in range(0, count, step):
        state = state.advanced(batch_of(values, first, min(first + step, count)))
    return state


def stilled(values: Values, *signals: Signal, at: float = 0.0) -> Values:
    return values | {signal: np.full(len(values[signal]), at) for signal in signals}


def absent(state: Liveness, least: int = LEAST_RECORDED) -> set[Signal]:
    return {found.signal for found in state.still(least)}


@pytest.mark.parametrize(
    "signals",
    [
        {Signal.INPUT_SPEED, Signal.CURRENT_GEAR},
        {Signal.INPUT1_SPEED, Signal.TARGET_GEAR},
        {Signal.OUTPUT_SPEED},
        {Signal.VEHICLE_SPEED, Signal.ENGINE_TORQUE},
        {Signal.ENGINE_SPEED},
    ],
)
def test_a_signal_that_stands_still_in_a_drive_through_the_gears_is_absent(signals: set[Signal]) -> None:
    state = heard(stilled(driven(1, 2, 3, 4, 3, 2), *signals))
    assert absent(state) == signals
    assert not state.is_settled


def test_what_it_stands_at_does_not_matter_and_is_told() -> None:
    values = stilled(driven(1, 2, 3), Signal.INPUT_SPEED, at=-10.0)
    (found,) = heard(values).still(LEAST_RECORDED)
    text = found.text("TCU11.N_TC")
    assert text.startswith("TCU11.N_TC is -95.49 rpm throughout: taken as absent (input shaft speed; engine and road")
    (none,) = heard(stilled(driven(1, 2, 3), Signal.CURRENT_GEAR)).still(LEAST_RECORDED)
    assert none.text("TCU12.CUR_GR").startswith(
        "TCU12.CUR_GR is 0 throughout: taken as absent (current gear; the ratio"
    )


def test_temperatures_states_and_whatever_lives_are_never_absent() -> None:
    state = heard(driven(1, 2, 3, 4, 3))
    assert absent(state, least=1) == set()
    assert state.is_settled


def test_nothing_is_absent_in_a_standing_car() -> None:
    assert absent(heard(standing()), least=1) == set()


def test_gears_and_the_other_shaft_may_stand_still_in_one_gear() -> None:
    values = stilled(driven(3, 3, 3, 3), Signal.CURRENT_GEAR, Signal.TARGET_GEAR, Signal.INPUT2_SPEED, at=3.0)
    assert absent(heard(values), least=1) == set()
    assert absent(heard(stilled(values, Signal.INPUT_SPEED))) == {Signal.INPUT_SPEED}  # the car moves


def test_a_clutch_that_never_closes_proves_nothing() -> None:
    values = driven(1, 2, 3, 2)
    slip = np.tile(np.linspace(1.9, 1.05, int(GEAR_S / PERIOD_S)), 4)  # it closes slowly, and opens again at once
    slipping = stilled(values, Signal.INPUT_SPEED, Signal.CURRENT_GEAR)
    slipping[Signal.ENGINE_SPEED] = slipping[Signal.ENGINE_SPEED] * slip
    assert absent(heard(slipping), least=1) == set()


def test_a_value_that_never_came_is_told_as_such() -> None:
    values = driven(1, 2, 3)
    gear = values.pop(Signal.CURRENT_GEAR)
    state = heard(values, state=Liveness.of({*values, Signal.CURRENT_GEAR}))
    (found,) = state.still(LEAST_RECORDED)
    assert (found.signal, found.value, len(gear) > 0) == (Signal.CURRENT_GEAR, None, True)
    assert "never had a value: taken as absent" in found.text("")


def test_a_live_signal_is_absent_after_three_changes_and_no_longer_when_it_moves() -> None:
    values = stilled(driven(1, 2, 3, 4, 3, 2), Signal.CURRENT_GEAR)
    state, count, history = Liveness.of(values.keys()), int(GEAR_S / PERIOD_S), list[set[Signal]]()
    for number in range(6):
        state = state.advanced(batch_of(values, number * count, (number + 1) * count))
        history.append(absent(state, LEAST_LIVE))
    assert history == [set(), set(), set(), {Signal.CURRENT_GEAR}, {Signal.CURRENT_GEAR}, {Signal.CURRENT_GEAR}]
    moving = driven(3, 2)
    later = replace(batch_of(moving, 0, 2 * count), breaks_before=True)
    assert absent(state.advanced(later), LEAST_LIVE) == set()


@pytest.mark.parametrize("step", [1, 7, 64])
def test_it_does_not_depend_on_how_the_stream_was_cut(step: int) -> None:
    values = stilled(driven(1, 2, 3, 4), Signal.INPUT_SPEED, Signal.CURRENT_GEAR)
    whole, cut = heard(values), heard(values, step)
    assert [(one.changes, one.rises, one.falls) for one in whole.couplings] == [
        (one.changes, one.rises, one.falls) for one in cut.couplings
    ]
    assert whole.still(LEAST_RECORDED) == cut.still(LEAST_RECORDED)


def test_a_few_damaged_values_are_no_motion() -> None:
    values = stilled(driven(1, 2, 3, 4), Signal.INPUT_SPEED)
    values[Signal.INPUT_SPEED][[50, 400]] = 700.0
    assert absent(heard(values)) == {Signal.INPUT_SPEED}


def test_a_jump_of_time_joins_no_two_stretches() -> None:
    first, second = (stilled(driven(gear), Signal.CURRENT_GEAR) for gear in (2, 3))
    state = heard(first)
    count = len(second[Signal.ENGINE_SPEED])
    state = state.advanced(batch_of(second, 0, count, breaks=True))
    assert {one.changes for one in state.couplings} == {1}  # another gear was driven, whenever it was engaged
