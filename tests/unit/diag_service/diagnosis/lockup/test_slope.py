"""The slope of a lock-up clutch whose pressure is commanded, of rows that are made by the law itself."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import Series
from clutch_results.event_kinds import Shudder
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.lockup.slope import RPM_10_RAD_S, LockupSlope, SlopeSurvey, slope_lines

ROW_S, RPM = 0.03, np.pi / 30.0
K_NMS2 = 0.0145


def columns_of(
    lining_s_rad: float, *, minutes: float = 12.0, error_nm: float = 0.0, moves: bool = True, swing_hz: float = 0.0
) -> dict[Signal, Series]:
    """Return a drive in which torque obeys the law, every minute open for 12 s; pressure follows the torque as read.

    The controller holds what it wants, but for a part of what the torque model does not know, to which slip gives way.
    """
    rng, t_s = np.random.default_rng(5), np.arange(0.0, 60.0 * minutes, ROW_S)
    phase = t_s % 60.0
    is_on = phase > 12.0
    places = (t_s / 8.0).astype(int)
    wanted = (rng.uniform(20.0, 60.0, places[-1] + 1) if moves else np.full(places[-1] + 1, 40.0))[places] * RPM
    asked = 60.0 + 80.0 * rng.random(places[-1] + 1)[(places * 3 // 4)]
    error = error_nm * rng.standard_normal(int(t_s[-1] / 5.0) + 2)[(t_s / 5.0).astype(int)]
    engine = 170.0 + 20.0 * np.sin(t_s / 40.0)
    rate = 0.5 * np.cos(t_s / 40.0)
    slip = np.where(is_on, wanted, asked / (K_NMS2 * engine))
    lining = asked - K_NMS2 * slip * engine - 0.25 * rate
    pressure = np.where(is_on, lining / 1.1e-3 / (1.0 + lining_s_rad * (slip - 40.0 * RPM)) + 3e4, 0.0)
    gives_way = np.where(is_on, 0.7 * error / asked / 0.03, 0.0)
    slip = np.where(is_on, np.maximum(slip - gives_way, 0.05), slip)
    slip += np.where(is_on, swing_hz and 1.6 * np.sin(2.0 * np.pi * swing_hz * t_s), 0.0)
    values = {
        Signal.ENGINE_SPEED: engine,
        Signal.TURBINE_SPEED: engine - slip,
        Signal.ENGINE_TORQUE: asked + error,
        Signal.LOCKUP_PRESSURE_COMMAND: pressure + np.where(is_on, error / 1.1e-3 * 0.3, 0.0),
        Signal.LOCKUP_SLIP_COMMAND: np.where(is_on, wanted, 0.0),
        Signal.SUMP_TEMPERATURE: np.where(t_s < 30.0 * minutes, 328.0, 338.0),
    }
    t_ns = np.round(1e9 * t_s).astype(np.int64)
    return {signal: Series(t_ns=t_ns, sequence=np.full(len(t_ns), -1), value=value) for signal, value in values.items()}


def told(columns: dict[Signal, Series], *, is_commanded: bool = True) -> LockupSlope:
    survey, t_ns = SlopeSurvey(is_commanded=is_commanded), columns[Signal.ENGINE_SPEED].t_ns
    for start, stop in zip(t_ns[::2000], [*t_ns[2000::2000], t_ns[-1] + 1], strict=True):
        part = {signal: series.between(int(start), int(stop)) for signal, series in columns.items()}
        survey.feed(
            ColumnBatch(columns={signal: one for signal, one in part.items() if len(one.t_ns)}, watermark_ns=int(stop))
        )
    slope = survey.slope()
    assert slope is not None
    return slope


@pytest.mark.parametrize("percent", [-2.0, 2.0])
def test_sign_and_interval_of_the_lining(percent: float) -> None:
    true = percent / 100.0 / RPM_10_RAD_S
    overall, *bins = told(columns_of(true)).slopes
    assert overall.lining.low_s_rad < true < overall.lining.high_s_rad
    assert overall.lining.word == ("rises" if percent > 0.0 else "falls")
    assert overall.together.mean_s_rad > overall.lining.mean_s_rad
    assert [part.name for part in bins] == ["oil of 50 to 60 °C", "oil of 60 to 70 °C"]
    assert all(part.lining.low_s_rad < true < part.lining.high_s_rad for part in bins)
    assert sum(part.slip_s for part in bins) == pytest.approx(overall.slip_s)


def test_the_converter_alone_damps_where_the_lining_does_nothing() -> None:
    overall = told(columns_of(0.0)).slopes[0]
    assert overall.lining.word == "undecided"
    assert overall.together.word == "rises"
    assert overall.together.low_s_rad < K_NMS2 * 170.0 / 100.0 < overall.together.high_s_rad


@pytest.mark.parametrize("is_wanted_told", [True, False])
def test_what_the_torque_model_does_not_know_is_no_falling_friction(is_wanted_told: bool) -> None:
    """A plain fit finds torque that does not depend on slip at all, and a lining that falls."""
    columns = columns_of(0.01, error_nm=6.0)
    if not is_wanted_told:
        del columns[Signal.LOCKUP_SLIP_COMMAND]
    slope = told(columns)
    overall = slope.slopes[0]
    assert overall.lining.word != "falls"
    assert overall.lining.low_s_rad < 0.01 < overall.lining.high_s_rad
    assert slope.feed_forward_r2 > 0.8
    assert any("follows the torque model" in line for line in slope.lines())


def test_slip_that_nobody_moves_tells_no_more_than_was_known() -> None:
    lining = told(columns_of(-0.02, error_nm=3.0, moves=False)).slopes[0].lining
    assert lining.word == "undecided"
    assert lining.high_s_rad - lining.low_s_rad > 0.08


def test_few_rows_tell_no_slope_and_say_so() -> None:
    slope = told(columns_of(0.0, minutes=0.5))
    assert slope.slopes == ()
    assert any(line.startswith("No slope") for line in slope.lines())
    assert not any("torque model" in line for line in slope_lines(slope))


def test_level_is_withheld_with_its_reason() -> None:
    columns = columns_of(0.0, minutes=2.0)
    assert "commanded" in told(columns).withheld
    columns[Signal.LOCKUP_PRESSURE] = columns.pop(Signal.LOCKUP_PRESSURE_COMMAND)
    assert "scale" in told(columns, is_commanded=False).withheld


def test_shudder_is_seen_at_its_frequency_and_not_made_up() -> None:
    swinging, calm = (told(columns_of(0.0, minutes=3.0, swing_hz=hertz)).shudder for hertz in (9.0, 0.0))
    assert isinstance(swinging, Shudder)
    assert swinging.seen_count > 10
    assert swinging.frequency_hz == pytest.approx(9.0, abs=0.6)
    assert calm is not None
    assert calm.seen_count == 0


def test_the_slip_control_hunts_slowly() -> None:
    hunting = told(columns_of(0.0, minutes=3.0, swing_hz=0.9)).hunting
    assert hunting is not None
    assert hunting.frequency_hz == pytest.approx(0.9, abs=0.1)


def test_applications_are_counted_with_their_heat() -> None:
    columns = columns_of(0.0, minutes=5.0)
    t_s, turbine = columns[Signal.TURBINE_SPEED].t_ns / 1e9, columns[Signal.TURBINE_SPEED]
    engine = columns[Signal.ENGINE_SPEED].value
    coming = np.clip((t_s % 60.0) - 12.0, 0.0, 1.0)
    ramp = (coming > 0.0) & (coming < 1.0)
    columns[Signal.TURBINE_SPEED] = replace(
        turbine, value=np.where(ramp, engine - 20.0 * (1.0 - coming), turbine.value)
    )
    heats_j = told(columns).application_heats_j
    assert len(heats_j) == 5
    assert all(50.0 < heat < 1000.0 for heat in heats_j)  # 60 to 140 N m, less the oil, over a second of 20 to 0 rad/s


def test_slip_alone_makes_the_turbine_and_a_jump_of_bus_time_a_gap() -> None:
    columns = columns_of(0.02)
    overall = told(columns).slopes[0]
    slip = columns[Signal.ENGINE_SPEED].value - columns[Signal.TURBINE_SPEED].value
    columns[Signal.LOCKUP_SLIP] = replace(columns.pop(Signal.TURBINE_SPEED), value=slip)
    assert told(columns).slopes[0].lining.mean_s_rad == pytest.approx(overall.lining.mean_s_rad, rel=1e-6)
    survey, end_ns = SlopeSurvey(is_commanded=True), int(columns[Signal.ENGINE_SPEED].t_ns[-1])
    survey.feed(ColumnBatch(columns=columns, watermark_ns=end_ns))
    survey.feed(ColumnBatch(columns=columns, watermark_ns=end_ns, breaks_before=True))
    twice = survey.slope()
    assert twice is not None
    assert twice.slopes[0].slip_s == pytest.approx(2.0 * overall.slip_s, rel=0.01)


def test_a_signal_that_never_came_leaves_nothing_to_tell() -> None:
    columns = columns_of(0.0, minutes=1.0)
    del columns[Signal.ENGINE_TORQUE]
    survey = SlopeSurvey(is_commanded=True)
    assert survey.slope() is None
    survey.feed(ColumnBatch(columns=columns, watermark_ns=60_000_000_000))
    assert survey.slope() is None
    assert not list(slope_lines(None))
