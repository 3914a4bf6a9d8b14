"""What speeds alone tell of a lock-up clutch."""

import numpy as np
import pytest

from canlog.arrays import Series
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.lockup.slip import LockupSlip, SlipSurvey, slip_lines

ROW_S = 0.03


def told(*, swing_hz: float = 0.0, has_turbine: bool = True) -> LockupSlip:
    """Return what is told of three minutes: each open for 20 s, held at 4 rad/s for 24 s, locked for 16 s."""
    t_s = np.arange(0.0, 180.0, ROW_S)
    phase = t_s % 60.0
    slip = np.select([phase < 20.0, phase < 44.0], [30.0, 4.0 + 1.5 * np.sin(2.0 * np.pi * swing_hz * t_s)], 0.05)
    engine = 180.0 + 10.0 * np.sin(t_s / 40.0)
    values = {Signal.ENGINE_SPEED: engine}
    values |= {Signal.TURBINE_SPEED: engine - slip} if has_turbine else {Signal.LOCKUP_SLIP: slip}
    t_ns = np.round(1e9 * t_s).astype(np.int64)
    columns = {
        signal: Series(t_ns=t_ns, sequence=np.full(len(t_ns), -1), value=value) for signal, value in values.items()
    }
    survey = SlipSurvey()
    for start in range(0, 180, 20):
        part = {signal: series.between(start * 10**9, (start + 20) * 10**9) for signal, series in columns.items()}
        survey.feed(ColumnBatch(columns=part, watermark_ns=(start + 20) * 10**9))
    slip_told = survey.slip()
    assert slip_told is not None
    return slip_told


@pytest.mark.parametrize("has_turbine", [True, False])
def test_it_is_told_how_long_slip_was_held_and_how_often_it_went(*, has_turbine: bool) -> None:
    slip = told(has_turbine=has_turbine)
    assert (slip.locked_s, slip.held_s, slip.open_s) == pytest.approx((48.0, 72.0, 60.0), abs=0.3)
    assert (slip.closing_count, slip.closing_times_s) == (3, ())  # it is held for longer than four seconds before
    text = "\n".join(slip_lines(slip))
    assert "Slip under 4 rpm for 48 s, up to 95 rpm for 72 s, more for 60 s." in text
    assert "Slip went below 95 rpm and stayed there: 3 times." in text
    assert "Shudder: none" in text
    assert "friction" not in text


def test_slip_that_swings_is_seen_with_its_frequency() -> None:
    shudder = told(swing_hz=9.4).shudder
    assert shudder is not None
    assert shudder.seen_count > 0.7 * shudder.window_count
    assert shudder.frequency_hz == pytest.approx(9.4, abs=0.6)


def test_without_speeds_nothing_is_told() -> None:
    assert SlipSurvey().slip() is None
