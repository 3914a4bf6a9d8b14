"""Blind prediction: shifts made by the law itself, with pressures and noise drawn, predicted from each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from canlog.arrays import FloatArray, Series
from clutch_results.event_kinds import EndReason
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.prediction import fitted, predicted, relative_friction, simulated
from diag_service.diagnosis.slip_phase import SlipPhase, slip_phase

TOUCH_PA, ROW_S = 1.4e5, 0.03
GEARS = GearRatios(over=Signal.OUTPUT_SPEED, ratios=(4.0, 2.5, 1.7, 1.2))


def phase(rng: np.random.Generator, to_gear: int = 2, *, noise_rad_s: float = 0.0, gain: float = 1.0) -> SlipPhase:
    """Make a slip phase whose engine loses 4 rad/s a second for each kPa above the touch point, 5 by clutch 1."""
    t_s = np.arange(-0.3, 0.61, ROW_S)
    rise = rng.uniform(2e6, 5e6)
    on_pa = TOUCH_PA + np.clip(rise * (t_s + 0.02), -TOUCH_PA, rng.uniform(3e5, 6e5))
    off_pa = np.maximum(TOUCH_PA - 2e6 * (t_s + 0.03), 0.0)
    drive = rng.uniform(3e-3, 5e-3)
    count = int(rng.integers(4, 8))
    made = SlipPhase(
        number=1, from_gear=to_gear - 1, to_gear=to_gear, is_powered=True, start_ns=0,
        t_s=np.asarray(ROW_S * np.arange(count), np.float64),
        speed_rad_s=np.full(count, 600.0), slip_rad_s=np.full(count, 200.0),
        on_pa=np.column_stack([t_s, on_pa]), off_pa=np.column_stack([t_s, off_pa]),
        drive=np.column_stack([t_s, np.full(len(t_s), drive)]),
    )  # fmt: skip
    rate = 2.5e5 * drive - (5.0 if made.clutch == 1 else 4.0) * gain * 1e-3 * np.maximum(on_pa - TOUCH_PA, 0.0)
    fine_s = np.arange(0.0, made.t_s[-1] + 1e-3, 1e-3)
    speed = 600.0 + np.cumsum(np.minimum(np.interp(fine_s, t_s, rate), 0.0)) * 1e-3
    speeds = np.interp(made.t_s, fine_s, speed) + rng.normal(0.0, noise_rad_s, count)
    return replace(made, speed_rad_s=speeds, slip_rad_s=speeds - 400.0)


def test_what_the_law_made_is_predicted() -> None:
    rng = np.random.default_rng(1)
    phases = [phase(rng, 2 + number % 2) for number in range(12)]
    model = fitted(phases[:10], TOUCH_PA)
    for one in phases[10:]:
        said = predicted(model, one)
        np.testing.assert_allclose(said.mean_rad_s, one.change_rad_s, rtol=0.06, atol=6.0)
        np.testing.assert_array_equal(said.mean_rad_s, simulated(model.parameters, model.scales, one))


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    inside = []
    for seed in range(24):
        rng = np.random.default_rng(100 + seed)
        phases = [phase(rng, 2 + number % 3, noise_rad_s=6.0, gain=rng.normal(1.0, 0.02)) for number in range(9)]
        said = predicted(fitted(phases[:8], TOUCH_PA), phases[8])
        size = said.scale_rad_s[-1] * stdtrit(said.freedom, 0.95)
        inside.append(abs(said.mean_rad_s[-1] - phases[8].change_rad_s[-1]) < size)
    assert np.mean(inside) >= 0.7  # of 24; with eight shifts to learn from 83 of 100 are, where 90 are asked


def series(t_s: FloatArray, value: FloatArray) -> Series:
    return Series(t_ns=np.rint(1e9 * t_s).astype(np.int64), sequence=np.full(len(t_s), -1), value=value)


def upshift(slip_s: float = 0.3, **left_out: bool) -> Event:
    # From the first gear to the second: the engine slips from one to the other within ``slip_s``.
    t_s = np.arange(0.0, 2.0, ROW_S)
    ratio = np.interp(t_s, [1.0, 1.0 + slip_s], GEARS.ratios[:2])
    columns = {
        Signal.ENGINE_SPEED: series(t_s, 150.0 * ratio),
        Signal.OUTPUT_SPEED: series(t_s, np.full(len(t_s), 150.0)),
        Signal.CLUTCH1_PRESSURE: series(t_s, np.full(len(t_s), 1e5)),
        Signal.CLUTCH2_PRESSURE: series(t_s, np.full(len(t_s), 4e5)),
        Signal.THROTTLE: series(t_s, np.full(len(t_s), 0.5)),
    }
    return Event(
        number=3, from_gear=1, to_gear=2, start_ns=800_000_000, end_ns=1_800_000_000, end_reason=EndReason.COMPLETE,
        columns={signal: one for signal, one in columns.items() if signal.name not in left_out}, bad_frame_count=0,
    )  # fmt: skip


def test_a_slip_phase_is_cut_from_the_old_gear_to_the_lock() -> None:
    found = slip_phase(upshift(), GEARS)
    assert isinstance(found, SlipPhase)
    assert (found.clutch, found.sign, found.is_powered) == (2, 1.0, True)
    assert found.slip_rad_s[-1] > 0.0
    assert found.speed_rad_s[0] == pytest.approx(600.0, rel=0.09)
    assert found.t_s[-1] == pytest.approx(0.3, abs=2 * ROW_S)
    assert found.mean_pa == 4e5


def test_rows_that_scatter_begin_no_slip_phase_early() -> None:
    event = upshift()
    engine = event.columns[Signal.ENGINE_SPEED]
    early = np.where((engine.t_ns > 850_000_000) & (engine.t_ns < 950_000_000), 1.0, 0.0)
    early[np.flatnonzero(early)[1:]] = 0.0
    scattered = replace(engine, value=engine.value - 30.0 * early)
    noisy = replace(event, columns={**event.columns, Signal.ENGINE_SPEED: scattered})
    found, sound = slip_phase(noisy, GEARS), slip_phase(event, GEARS)
    assert isinstance(found, SlipPhase)
    assert isinstance(sound, SlipPhase)
    assert found.start_ns == sound.start_ns


def with_friction(ratios: FloatArray, rng: np.random.Generator) -> list[SlipPhase]:
    """Make shifts 2-3 and 3-4 by turns, whose friction has these ratios; none in which the engine hardly slows down."""
    made: list[SlipPhase] = []
    while len(made) < len(ratios):
        place = len(made)
        one = phase(rng, 3 + place % 2, noise_rad_s=2.0, gain=float(ratios[place]))
        made += [replace(one, number=place)] if one.change_rad_s[-1] < -20.0 else []
    return made


def test_the_shift_whose_friction_was_lower_is_told_up_to_a_scale() -> None:
    wrong, inside = 5, []
    ratios = np.where(np.arange(12) == wrong, 0.8, 1.0)
    for seed in range(12):
        phases = with_friction(ratios, np.random.default_rng(seed))
        found = {one.clutch: one.shifts for one in relative_friction(phases, TOUCH_PA)}
        low = found[2][wrong]
        assert low.value + 2.0 * low.std < 1.0
        shifts = [pair for clutch in found.values() for pair in clutch.items()]
        inside += [abs(one.value - ratios[number]) < 2.0 * one.std for number, one in shifts]
    assert len(inside) == 12 * len(ratios)
    assert np.mean(inside) >= 0.9


def test_a_slip_phase_does_not_begin_before_the_on_coming_clutch_has_pressure() -> None:
    event = upshift()
    output, t_s = event.columns[Signal.OUTPUT_SPEED], np.arange(0.0, 2.0, ROW_S)
    skewed = replace(output, value=np.where((t_s > 0.82) & (t_s < 1.0), 1.07, 1.0) * output.value)  # rough ground
    on_pa = series(t_s, np.interp(t_s, [0.98, 1.06], [0.0, 4e5]))
    off_pa = series(t_s, np.interp(t_s, [0.98, 1.06], [4e5, 0.0]))
    pressures = {Signal.CLUTCH1_PRESSURE: off_pa, Signal.CLUTCH2_PRESSURE: on_pa}
    found = slip_phase(replace(event, columns={**event.columns, Signal.OUTPUT_SPEED: skewed, **pressures}), GEARS)
    assert isinstance(found, SlipPhase)
    assert found.start_ns >= 960_000_000


def test_shifts_that_are_known_badly_say_first_that_they_tell_nothing() -> None:
    phases = with_friction(np.ones(6), np.random.default_rng(3))
    clear = next(relative_friction(phases, TOUCH_PA))
    vague = replace(clear, shifts={number: replace(one, std=0.4) for number, one in clear.shifts.items()})
    assert (clear.silence, vague.silence) == ("", "tells nothing: friction of a shift is known to ± 80 % at best")
    assert str(vague).startswith("clutch 1 tells nothing: friction of a shift is known to ± 80 % at best, friction of")
