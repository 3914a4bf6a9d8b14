"""One shift in, one friction estimate and a new running state out."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clutch_model.calibration import Calibration
from clutch_model.gears import clutch_of_gear, with_clutch
from diag_service.diagnosis.alignment import NS_TO_S, AlignedSignals, compile_alignment
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.balance import Balance
from diag_service.diagnosis.friction.film_track import compile_film
from diag_service.diagnosis.friction.filter_state import FilterState, Misfit
from diag_service.diagnosis.friction.parameters import State, friction_rows
from diag_service.diagnosis.friction.preparation import measured_drives, slip_window, zeroed
from diag_service.diagnosis.friction.scale_free import scale_free
from diag_service.diagnosis.friction.window import SlipWindow
from diag_service.diagnosis.quality.plausibility import SlippingClutch, plausibility_faults, zero_has_jumped
from diag_service.diagnosis.quality.usability import usable_signals
from diag_service.diagnosis.records import Reason, ShiftEstimate, Status

if TYPE_CHECKING:
    from canlog.arrays import FloatArray

ALGORITHM_VERSION = "torque-impulse-4"
PASS_COUNT = 3  # each takes away what planned and measured pressures differ by, a few percent
INNOVATION_GATE = 25.0  # squared distance of a shift from the running state, two degrees of freedom: 4e-6 by chance
REFUSALS_TO_YIELD = 3  # in a row: then the clutch has changed, and the running state starts afresh
SCORE_GATE = 4.5  # by chance one clean shift in 13,000; a latency or width that the type does not have
FULL_WINDOW_S = 0.25  # the shortest slip window that every regular shift offers


class Estimator:
    """Estimates friction from shifts; holds nothing but the calibration."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration

    def prepare(self) -> None:
        """Have everything compiled before the first shift comes: it must not wait for it."""
        compile_alignment()
        compile_film(self._calibration)

    def estimate(
        self, event: Event, state: FilterState, *, is_described_only: bool = False
    ) -> tuple[FilterState, ShiftEstimate]:
        """Return the running state after a shift, and what the shift alone says about the on-coming clutch.

        The shift's own estimate uses what is known of offsets, but not the running friction. A shift whose signals
        contradict each other, or that does not fit the model, is rejected; one that fits, but contradicts the running
        state, is shown and kept out of it, until three in a row agree that the clutch has changed. One that is
        described only, because its data are not believed, is not even held against the running state.
        """
        signals = usable_signals(event, self._calibration)
        if isinstance(signals, Reason):
            return state, without_friction(event, Status.REJECTED, signals)
        clutch = clutch_of_gear(event.to_gear)
        before, state = state, zeroed(signals, state, self._calibration)
        if zero_has_jumped(before.pressure_zeros, state.pressure_zeros):
            return before, without_friction(event, Status.REJECTED, Reason.ZERO_JUMPED)
        drives = measured_drives(signals, state, event, self._calibration)
        window = slip_window(signals, drives, clutch, self._calibration)
        if window is None:
            return state, without_friction(event, Status.UNOBSERVED, Reason.NO_SLIP_WINDOW)
        slipping = SlippingClutch(
            number=clutch,
            rows=window.rows,
            pressure_zero_pa=float(state.pressure_zeros.mean_pa[clutch - 1]),
        )
        if faults := plausibility_faults(event, signals, slipping):
            return before, without_friction(event, Status.REJECTED, *faults)
        balance = Balance(signals, window, drives, self._calibration)
        alone, misfit, gate = self._fit(balance, state.forget_friction(clutch, self._calibration))
        ratio = misfit.chi_square_ratio
        fit = min(1.0, max(0.0, (gate - ratio) / (gate - 1.0)))
        estimate = replace(self._describe(event, signals, window, balance, alone, fit), chi_square_ratio=ratio)
        warmed = state.warmed(balance.final_clutch_k, event.end_ns)
        is_misfit = ratio > gate or misfit.worst_score > SCORE_GATE
        if is_misfit:
            estimate = replace(
                estimate, status=Status.REJECTED, reasons=(Reason.MISFIT,), friction=None, scale_free=None
            )
        if is_misfit or is_described_only:
            return warmed, estimate
        return self._combined(warmed, balance, clutch, alone, estimate)

    def _fit(self, balance: Balance, prior: FilterState) -> tuple[FilterState, Misfit, float]:
        """Return the posterior, how well it fits, and the largest chi-square per degree of freedom that is believed."""
        posterior, misfit, gate = prior, Misfit(chi_square_ratio=math.inf, worst_score=math.inf), 0.0
        at = prior.mean
        for _ in range(PASS_COUNT):
            seen = balance.measurement(at, prior.mean)
            gate = seen.misfit_gate
            posterior, misfit = prior.updated(seen)
            at = np.concatenate((posterior.mean[: State.TORQUE_OFFSET], prior.mean[State.TORQUE_OFFSET :]))
        return posterior, misfit, gate

    def _combined(
        self, state: FilterState, balance: Balance, clutch: int, alone: FilterState, estimate: ShiftEstimate
    ) -> tuple[FilterState, ShiftEstimate]:
        """Fold the shift into the running state, unless it contradicts it."""
        count, refused = state.shift_counts[clutch - 1], state.refused_counts[clutch - 1]
        if count and _normalised_innovation(state, alone, clutch) > INNOVATION_GATE:
            if refused + 1 < REFUSALS_TO_YIELD:
                kept = replace(state, refused_counts=with_clutch(state.refused_counts, clutch, refused + 1))
                return kept, replace(estimate, reasons=(Reason.NOT_UPDATED,))
            state = state.forget_friction(clutch, self._calibration)
            count = 0
        posterior, _, _ = self._fit(balance, state.drifted())
        counted = replace(
            posterior,
            shift_counts=with_clutch(state.shift_counts, clutch, count + 1),
            refused_counts=with_clutch(state.refused_counts, clutch, 0),
        )
        return counted.counted(clutch, estimate.end_ns), estimate

    def _describe(
        self,
        event: Event,
        signals: AlignedSignals,
        window: SlipWindow,
        balance: Balance,
        alone: FilterState,
        fit: float,
    ) -> ShiftEstimate:
        """Describe what a shift says alone; ``fit`` is 1 for no misfit, 0 at its gate."""
        clutch = clutch_of_gear(event.to_gear)
        window_s = float(signals.grid_s[window.stop - 1] - signals.grid_s[window.first])
        mu: FloatArray = alone.mean[friction_rows(clutch)]
        return replace(
            without_friction(event, Status.VALID),
            friction=alone.friction(clutch),
            scale_free=scale_free(alone, clutch),
            sample_count=balance.sample_count,
            window_s=window_s,
            quality=fit * min(1.0, window_s / FULL_WINDOW_S) / (1.0 + event.bad_frame_count / balance.sample_count),
            clutch_temperature_k=balance.final_clutch_k[clutch - 1],
            slip_energy_j=balance.slip_energy_j(clutch, mu),
        )


def _normalised_innovation(state: FilterState, alone: FilterState, clutch: int) -> float:
    """Return the squared distance between a shift's own friction and the running one, common scale left out."""
    rows = friction_rows(clutch)
    spread = state.covariance[rows, rows] + alone.covariance[rows, rows]
    step = alone.mean[rows] - state.mean[rows]
    return float(step @ np.linalg.solve(spread, step))


def without_friction(event: Event, status: Status, *reasons: Reason) -> ShiftEstimate:
    """Return the estimate of a shift that says nothing of friction: when and what it was, and why not."""
    return ShiftEstimate(
        number=event.number,
        from_gear=event.from_gear,
        to_gear=event.to_gear,
        clutch=clutch_of_gear(event.to_gear),
        start_ns=event.start_ns,
        end_ns=event.end_ns,
        status=status,
        reasons=reasons,
        friction=None,
        sample_count=0,
        window_s=0.0,
        chi_square_ratio=0.0,
        quality=0.0,
        sump_temperature_k=_mean(event, Signal.SUMP_TEMPERATURE),
        clutch_temperature_k=None,
        slip_energy_j=None,
        duration_s=(event.end_ns - event.start_ns) * NS_TO_S,
        odometer_m=_mean(event, Signal.ODOMETER),
    )


def _mean(event: Event, signal: Signal) -> float | None:
    series = event.columns.get(signal)
    return float(np.mean(series.value)) if series is not None and len(series.value) else None
