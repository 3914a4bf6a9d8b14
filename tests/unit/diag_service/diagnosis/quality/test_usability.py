"""Whether the signals of a shift can be put on one clock: a reason for each way in which they cannot."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from clutch_results.records import Reason
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals, usable_signals
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import Event
from tests.support.shifts_of_a_drive import changed, first_shifts, thinned, without

CALIBRATION = nominal_calibration()


def without_samples(event: Event, signal: Signal) -> Event:
    return thinned(event, signal, slice(None))


def with_oil(event: Event, oil_k: float) -> Event:
    return changed(event, Signal.SUMP_TEMPERATURE, lambda t_s, _: np.full(len(t_s), oil_k))


def with_times_that_jump_back(event: Event) -> Event:
    torque = event.columns[Signal.ENGINE_TORQUE]
    t_ns = torque.t_ns.copy()
    t_ns[20] = t_ns[18]
    turned = replace(torque, t_ns=t_ns, sequence=np.full_like(torque.sequence, -1))
    return replace(event, columns={**event.columns, Signal.ENGINE_TORQUE: turned})


def test_the_signals_of_a_sound_shift_come_on_one_grid() -> None:
    event = first_shifts()[0]
    signals = usable_signals(event, CALIBRATION)
    assert isinstance(signals, AlignedSignals)
    assert np.diff(signals.grid_s) == pytest.approx(GRID_S)
    speeds = (signals.engine_speed, signals.hub_speed, *signals.input_speed)
    for one in (*speeds, signals.engine_torque, *signals.pressure):
        assert len(one.on_grid) == len(signals.grid_s)
        assert one.times_s[0] <= signals.grid_s[0]
    assert all(expected is not None for expected in signals.expected_pa)
    slip_rad_s = signals.hub_speed.on_grid - signals.input_speed[1].on_grid
    assert np.array_equal(signals.slip_rad_s[1], slip_rad_s)


@pytest.mark.parametrize("signal", [*BALANCE_SIGNALS, Signal.SUMP_TEMPERATURE])
def test_a_signal_that_is_missing(signal: Signal) -> None:
    assert usable_signals(without(first_shifts()[0], signal), CALIBRATION) is Reason.SIGNAL_MISSING


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda event: replace(event, end_reason=EndReason.TOO_LONG), Reason.INTERRUPTED),
        (lambda event: replace(event, end_reason=EndReason.INTERRUPTED), Reason.INTERRUPTED),
        (lambda event: without_samples(event, Signal.SUMP_TEMPERATURE), Reason.SIGNAL_MISSING),
        (lambda event: without_samples(event, Signal.HUB_SPEED), Reason.FRAMES_MISSING),
        (lambda event: thinned(event, Signal.CLUTCH2_PRESSURE, slice(80, 88)), Reason.FRAMES_MISSING),
        (lambda event: with_oil(event, 232.0), Reason.OUT_OF_RANGE),
        (lambda event: with_oil(event, 444.0), Reason.OUT_OF_RANGE),
        (with_times_that_jump_back, Reason.TIME_UNSURE),
    ],
)
def test_what_cannot_be_used_says_why(spoil: Callable[[Event], Event], reason: Reason) -> None:
    assert usable_signals(spoil(first_shifts()[0]), CALIBRATION) is reason
