"""Indices of made-up gear changes that are known exactly: errors stay within what is stated, at rates of all buses."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason, EventKind, NotMeasured, ShiftIndices
from clutch_results.records import dump, parse_shift, shift_record
from diag_service.diagnosis.alignment import COMMAND_LAG_S
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.condition.shift_indices import measure
from diag_service.diagnosis.condition.shift_quality import ShiftScorer
from diag_service.diagnosis.events import Event
from tests.support.builders import shift_result

CALIBRATION = nominal_calibration()
SIDE = CALIBRATION.input_side
INERTIA_KG_M2 = SIDE.engine_inertia_kg_m2 + SIDE.hub_inertia_kg_m2
ORIGIN_NS = 1_000_000_000_000
BEGIN_S, CLOSING_S, CLOSED_S, END_S = 0.0, 0.4, 0.9, 1.2  # of the gears; of the slip, which lasts from the beginning
OLD_RATIO, NEW_RATIO = 2.0, 1.5
DRAWS = 120
TORQUE_NM = 120.0
MEASURES: Final = ("shift_time_s", "slip_duration_s", "peak_slip_rad_s")


def output_rad_s(t_s: FloatArray) -> FloatArray:
    return 120.0 + 6.0 * t_s


def engine_rad_s(t_s: FloatArray) -> FloatArray:
    """Return the engine's speed: of the old gear, then along half a cosine to that of the new one."""
    share = 0.5 - 0.5 * np.cos(np.pi * np.clip((t_s - CLOSING_S) / (CLOSED_S - CLOSING_S), 0.0, 1.0))
    return np.asarray(((1.0 - share) * OLD_RATIO + share * NEW_RATIO) * output_rad_s(t_s))


def slip_rad_s(t_s: FloatArray) -> FloatArray:
    return engine_rad_s(t_s) - NEW_RATIO * output_rad_s(t_s)


FINE_S: Final = np.arange(BEGIN_S, END_S, 1e-4)
TRUE: Final = {
    "shift_time_s": END_S - BEGIN_S,
    "slip_duration_s": 1e-4 * np.count_nonzero(slip_rad_s(FINE_S) > 5.0),
    "peak_slip_rad_s": float(slip_rad_s(FINE_S).max()),
    "ratio_before": OLD_RATIO,
    "ratio_after": NEW_RATIO,
}


@dataclass(frozen=True, kw_only=True)
class Bus:
    """How the signals of a gear change are sampled."""

    speed_s: float = 0.01
    gear_s: float = 0.01
    noise_rad_s: float = 0.2
    step_rad_s: float = 0.026  # 0.25 rpm
    lost_ratio: float = 0.0
    shafts: bool = True
    torques: bool = False
    extra: Mapping[Signal, Callable[[FloatArray], FloatArray]] = field(default_factory=dict)


def sampled(value: Callable[[FloatArray], FloatArray], bus: Bus, rng: np.random.Generator, *, is_gear: bool) -> Series:
    period_s = bus.gear_s if is_gear else bus.speed_s
    t_s = np.arange(-0.5 + rng.uniform(0.0, period_s), END_S + 0.2 + bus.gear_s, period_s)
    t_s = t_s[rng.random(len(t_s)) >= bus.lost_ratio]
    read = value(t_s)
    if not is_gear:
        read = bus.step_rad_s * np.round((read + rng.normal(0.0, bus.noise_rad_s, len(t_s))) / bus.step_rad_s)
    t_ns = ORIGIN_NS + np.rint(1e9 * t_s).astype(np.int64)
    return Series(t_ns=t_ns, sequence=np.arange(len(t_s)), value=read, period_ns=round(1e9 * period_s))


def change(bus: Bus, seed: int = 0, *, gears: tuple[int, int] = (1, 2), end_s: float = END_S) -> Event:
    """Return a gear change as a bus tells it: it begins and ends with the first sample of gears that says so."""
    rng = np.random.default_rng(seed)
    old, new = gears
    target = sampled(lambda t_s: np.where(t_s >= BEGIN_S, float(new), float(old)), bus, rng, is_gear=True)
    current = replace(target, value=np.where(target.t_ns >= ORIGIN_NS + round(1e9 * end_s), float(new), float(old)))
    speeds: dict[Signal, Callable[[FloatArray], FloatArray]] = {
        Signal.ENGINE_SPEED: engine_rad_s,
        Signal.HUB_SPEED: engine_rad_s,  # that of the engine is a mean over a crank segment
        Signal.OUTPUT_SPEED: output_rad_s,
    }
    if bus.shafts:
        speeds |= {
            Signal.INPUT1_SPEED: lambda t_s: OLD_RATIO * output_rad_s(t_s),
            Signal.INPUT2_SPEED: lambda t_s: NEW_RATIO * output_rad_s(t_s),
        }
    columns = {signal: sampled(value, bus, rng, is_gear=False) for signal, value in (speeds | dict(bus.extra)).items()}
    return Event(
        kind=EventKind.POWER_ON_UPSHIFT,
        number=1,
        from_gear=old,
        to_gear=new,
        start_ns=int(target.t_ns[np.flatnonzero(target.value == new)[0]]),
        end_ns=int(target.t_ns[np.flatnonzero(current.value == new)[0]]),
        end_reason=EndReason.COMPLETE,
        bad_frame_count=0,
        columns={**columns, Signal.TARGET_GEAR: target, Signal.CURRENT_GEAR: current},
    )


def without_output(event: Event) -> dict[Signal, Series]:
    return {signal: series for signal, series in event.columns.items() if signal != Signal.OUTPUT_SPEED}


def stated(found: ShiftIndices, measure_name: str) -> tuple[float, float]:
    value, std = getattr(found, measure_name), getattr(found, f"std_{measure_name}")
    assert value is not None
    assert std is not None
    return value, std


RATES = [
    pytest.param(Bus(), id="10 ms"),
    pytest.param(Bus(speed_s=0.02, gear_s=0.1), id="20 ms, gears 100 ms"),
    pytest.param(Bus(speed_s=0.05, gear_s=0.05, shafts=False), id="50 ms, speeds alone"),
    pytest.param(Bus(noise_rad_s=1.0, step_rad_s=1.05), id="noise, steps of 10 rpm"),
    pytest.param(Bus(lost_ratio=0.2), id="every fifth frame lost"),
]


@pytest.mark.parametrize("bus", RATES)
def test_errors_are_within_what_is_stated(bus: Bus) -> None:
    ends_s = END_S + np.random.default_rng(1).uniform(0.0, 0.1, DRAWS)
    found = [measure(change(bus, seed, end_s=end_s), CALIBRATION) for seed, end_s in enumerate(ends_s.tolist())]
    for name in (*MEASURES, "ratio_before", "ratio_after"):
        values, stds = np.array([stated(one, name) for one in found]).T
        errors = values - (ends_s - BEGIN_S if name == "shift_time_s" else TRUE[name])
        assert np.mean(np.abs(errors) < 2.0 * stds) >= 0.9, name
        if name in MEASURES:  # ratios and slip bear that speeds may be up to a cycle old, which these are not
            assert np.median(stds) < 3.0 * float(np.sqrt(np.mean(errors**2))) + 0.01, name


def test_a_gear_change_is_known_to_the_gap_of_its_gear_signals() -> None:
    found = measure(change(Bus(gear_s=0.1)), CALIBRATION)
    assert found.std_shift_time_s == pytest.approx(0.1 / math.sqrt(6.0), rel=0.01)


def test_lost_frames_at_its_beginning_make_a_gear_change_less_sure() -> None:
    event = change(Bus())
    sure = measure(event, CALIBRATION)
    gaps = {}
    for signal in (Signal.TARGET_GEAR, Signal.CURRENT_GEAR):
        series = event.columns[signal]
        kept = (series.t_ns >= event.start_ns) | (series.t_ns < event.start_ns - 80_000_000)
        gaps[signal] = replace(series, t_ns=series.t_ns[kept], sequence=series.sequence[kept], value=series.value[kept])
    unsure = measure(replace(event, columns={**event.columns, **gaps}), CALIBRATION)
    assert sure.std_shift_time_s is not None
    assert unsure.std_shift_time_s is not None
    assert unsure.std_shift_time_s > 5.0 * sure.std_shift_time_s
    assert unsure.shift_time_s == sure.shift_time_s


def test_without_output_speed_there_is_no_ratio_and_no_slip_of_speeds_alone() -> None:
    event = change(Bus(shafts=False))
    less = without_output(event)
    found = measure(replace(event, columns=less), CALIBRATION)
    assert (found.ratio_before, found.slip_duration_s, found.peak_slip_rad_s) == (None, None, None)
    assert found.shift_time_s is not None
    missing = {name for name, why in found.not_measured.items() if why == NotMeasured.SIGNAL_MISSING}
    assert missing >= {"ratio_before", "ratio_after", "slip_duration_s", "slip_energy_j", "jerk_m_s3"}


def test_a_ratio_is_told_only_while_the_clutch_is_locked() -> None:
    event = change(Bus(shafts=False))
    early = replace(event, end_ns=event.start_ns + 600_000_000)  # amid the slip
    cut = {
        signal: replace(series, t_ns=series.t_ns[is_in], sequence=series.sequence[is_in], value=series.value[is_in])
        for signal, series in event.columns.items()
        if (is_in := series.t_ns < early.end_ns + 100_000_000) is not None
    }
    found = measure(replace(early, columns=cut), CALIBRATION)
    assert (found.ratio_after, found.not_measured["ratio_after"]) == (None, NotMeasured.NOT_LOCKED)
    assert found.not_measured["slip_duration_s"] == NotMeasured.NOT_LOCKED
    described = measure(
        replace(early, columns=cut), CALIBRATION, GearRatios(over=Signal.OUTPUT_SPEED, ratios=(2.0, 1.5))
    )
    assert described.peak_slip_rad_s == pytest.approx(TRUE["peak_slip_rad_s"], abs=2.0)


def test_gears_of_one_shaft_tell_no_slip_by_speeds_alone() -> None:
    found = measure(change(Bus(shafts=False), gears=(4, 2)), CALIBRATION)
    assert (found.slip_duration_s, found.not_measured["slip_duration_s"]) == (None, NotMeasured.SHAFT_UNKNOWN)
    assert found.ratio_after == pytest.approx(NEW_RATIO, abs=0.01)


def test_out_of_neutral_slip_is_told() -> None:
    found = measure(change(Bus(shafts=False), gears=(0, 2)), CALIBRATION)
    assert found.slip_duration_s == pytest.approx(TRUE["slip_duration_s"], abs=0.05)


def test_one_sample_of_each_signal_tells_nothing_but_the_time() -> None:
    event = change(Bus())
    single = {
        signal: replace(series, t_ns=series.t_ns[60:61], sequence=series.sequence[60:61], value=series.value[60:61])
        for signal, series in event.columns.items()
    }
    found = measure(replace(event, columns=single), CALIBRATION)
    told = {name for name in ShiftIndices.__dataclass_fields__ if getattr(found, name) is not None}
    assert told == {"shift_time_s", "std_shift_time_s", "not_measured"}


def judder(amplitude_rad_s: float, frequency_hz: float) -> Callable[[FloatArray], FloatArray]:
    return lambda t_s: engine_rad_s(t_s) + amplitude_rad_s * np.sin(2.0 * np.pi * frequency_hz * t_s)


@pytest.mark.parametrize("period_s", [0.01, 0.02])
def test_judder_is_the_root_mean_square_of_its_band(period_s: float) -> None:
    still = measure(change(Bus(speed_s=period_s)), CALIBRATION)
    shaken = measure(change(Bus(speed_s=period_s, extra={Signal.HUB_SPEED: judder(4.0, 8.0)})), CALIBRATION)
    (little, _), (much, std) = stated(still, "judder_rad_s"), stated(shaken, "judder_rad_s")
    assert little < 0.5
    assert abs(math.sqrt(much**2 - little**2) - 4.0 / math.sqrt(2.0)) < 2.0 * std + 0.1


def test_judder_needs_forty_samples_a_second_and_slip_that_lasts() -> None:
    slow = measure(change(Bus(speed_s=0.03)), CALIBRATION)
    assert (slow.judder_rad_s, slow.not_measured["judder_rad_s"]) == (None, NotMeasured.SAMPLED_TOO_SLOWLY)
    event = change(Bus())
    short = measure(replace(event, start_ns=event.start_ns + 600_000_000), CALIBRATION)
    assert (short.judder_rad_s, short.not_measured["judder_rad_s"]) == (None, NotMeasured.SLIP_TOO_SHORT)


def rising(t_s: FloatArray) -> FloatArray:
    """Return a car's speed whose acceleration rises from 1 to 2 m/s2 within 0.1 s: a jerk of 10 m/s3."""
    return 20.0 + t_s + 5.0 * np.clip(t_s - 0.5, 0.0, 0.1) ** 2 + np.clip(t_s - 0.6, 0.0, None)


def rising_true() -> float:
    t_s = np.arange(-0.5, 1.7, 1e-3)
    along = np.arange(-80, 81)
    slopes = np.correlate(rising(t_s), along, "valid") / (along @ along) * 1e3
    return float(np.abs(slopes[100:] - slopes[:-100]).max()) / 0.1


@pytest.mark.parametrize("period_s", [0.01, 0.02, 0.05])
def test_jerk_is_the_change_of_acceleration_within_a_tenth_of_a_second(period_s: float) -> None:
    bus = Bus(speed_s=period_s, noise_rad_s=0.01, step_rad_s=0.003, extra={Signal.VEHICLE_SPEED: rising})
    found = [stated(measure(change(bus, seed), CALIBRATION), "jerk_m_s3") for seed in range(40)]
    errors, stds = np.array([(value - rising_true(), std) for value, std in found]).T
    assert np.mean(np.abs(errors) < 2.0 * stds) >= 0.9
    assert float(np.median(stds)) < 5.0


def test_a_speed_in_steps_of_a_kilometre_an_hour_tells_no_jerk_and_costs_no_score() -> None:
    coarse = Bus(noise_rad_s=0.0, step_rad_s=1.0 / 3.6, extra={Signal.VEHICLE_SPEED: rising})
    event = change(coarse)
    less = without_output(event)
    event = replace(event, columns=less)
    found = measure(event, CALIBRATION)
    assert (found.jerk_m_s3, found.not_measured["jerk_m_s3"]) == (None, NotMeasured.TOO_COARSE)
    quality = ShiftScorer(CALIBRATION, None).score(event, None)
    assert quality is not None
    assert quality.parts.jerk_m_s3 is None
    fine = Bus(noise_rad_s=0.002, step_rad_s=0.003)
    turning = sampled(rising, fine, np.random.default_rng(1), is_gear=False)
    wheels = replace(event, columns={**less, Signal.WHEEL_RL_SPEED: turning})
    assert measure(wheels, CALIBRATION).jerk_m_s3 == pytest.approx(rising_true(), abs=2.0)
    by_wheels = ShiftScorer(CALIBRATION, None).score(wheels, None)
    assert by_wheels is not None
    assert by_wheels.parts.jerk_m_s3 == pytest.approx(rising_true(), abs=2.0)


def capacity_nm(t_s: FloatArray) -> FloatArray:
    """Return the torque of the on-coming clutch: none, then in 0.2 s all of the engine's."""
    return TORQUE_NM * np.clip((t_s - 0.1) / 0.2, 0.0, 1.0)


def asked_nm(t_s: FloatArray) -> FloatArray:
    """Return what is asked of the clutch, which follows late."""
    return capacity_nm(t_s + COMMAND_LAG_S)


def heated(*, is_asked: bool = True) -> Bus:
    def engine_nm(t_s: FloatArray) -> FloatArray:
        latent_s = t_s - CALIBRATION.bias.torque_latency_s
        acceleration = (engine_rad_s(latent_s + 1e-4) - engine_rad_s(latent_s - 1e-4)) / 2e-4
        return np.asarray(TORQUE_NM + INERTIA_KG_M2 * acceleration)

    extra: dict[Signal, Callable[[FloatArray], FloatArray]] = {Signal.ENGINE_TORQUE: engine_nm}
    if is_asked:
        extra |= {
            Signal.CLUTCH2_TORQUE_COMMAND: asked_nm,
            Signal.CLUTCH1_TORQUE_COMMAND: lambda t_s: TORQUE_NM - asked_nm(t_s),
        }
    return Bus(extra=extra)


TRUE_HEAT_J: Final = 1e-4 * float(np.sum((capacity_nm(FINE_S) * slip_rad_s(FINE_S))[slip_rad_s(FINE_S) > 5.0]))


def test_heat_is_the_torque_of_the_clutch_times_its_slip() -> None:
    value, std = stated(measure(change(heated()), CALIBRATION), "slip_energy_j")
    assert value == pytest.approx(TRUE_HEAT_J, rel=0.05)
    assert 0.02 * TRUE_HEAT_J < std < 0.2 * TRUE_HEAT_J  # gain 3 %, offset 5 Nm of 120, inertia


def test_heat_is_less_sure_where_nothing_tells_how_torque_is_handed_over() -> None:
    told = stated(measure(change(heated()), CALIBRATION), "slip_energy_j")
    value, std = stated(measure(change(heated(is_asked=False)), CALIBRATION), "slip_energy_j")
    assert std > 1.5 * told[1]
    assert abs(value - TRUE_HEAT_J) < 2.0 * std


def test_an_event_broken_off_has_no_indices_and_says_so() -> None:
    found = measure(replace(change(Bus()), end_reason=EndReason.INTERRUPTED), CALIBRATION)
    assert found == ShiftIndices(not_measured={"shift_time_s": NotMeasured.NOT_COMPLETED})


DAMAGED: Final = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(DAMAGED, min_size=1, max_size=12),
    signal=st.sampled_from([Signal.ENGINE_SPEED, Signal.HUB_SPEED, Signal.OUTPUT_SPEED, Signal.INPUT2_SPEED,
                            Signal.VEHICLE_SPEED, Signal.ENGINE_TORQUE, Signal.CLUTCH2_TORQUE_COMMAND]),
    first=st.integers(0, 150),
)  # fmt: skip
def test_whatever_a_log_holds_indices_are_numbers_and_travel(values: list[float], signal: Signal, first: int) -> None:
    event = change(heated())
    event = replace(event, columns={**event.columns, Signal.VEHICLE_SPEED: event.columns[Signal.OUTPUT_SPEED]})
    series = event.columns[signal]
    damaged = series.value.copy()
    place = slice(min(first, len(damaged) - len(values)), None)
    damaged[place][: len(values)] = values
    found = measure(replace(event, columns={**event.columns, signal: replace(series, value=damaged)}), CALIBRATION)
    told = [getattr(found, name) for name in ShiftIndices.__dataclass_fields__ if name != "not_measured"]
    assert all(value is None or math.isfinite(value) for value in told)
    assert all(std is None or std >= 0.0 for name, std in vars_of(found).items() if name.startswith("std_"))
    result = shift_result()
    result = replace(result, estimate=replace(result.estimate, indices=found))
    assert parse_shift(dump(shift_record(result))) == result


def vars_of(found: ShiftIndices) -> dict[str, float | None]:
    return {name: getattr(found, name) for name in ShiftIndices.__dataclass_fields__ if name != "not_measured"}
