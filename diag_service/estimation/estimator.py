"""One shift in, one friction estimate and a new running state out."""

import math
from dataclasses import replace

import numpy as np

from clutch_model.calibration import Calibration
from diag_service.estimation.balance import Balance
from diag_service.estimation.belief import Belief, Considered, Measurement, State, friction_rows
from diag_service.estimation.film_track import PressureDrive
from diag_service.estimation.sampling import NS_TO_S
from diag_service.estimation.signals import ShiftSignals, gather
from diag_service.estimation.window import SlipWindow, find_window
from diag_service.records import FloatArray, Reason, ShiftEstimate, ShiftEvent, Signal, Status

ALGORITHM_VERSION = "torque-impulse-1"
PASS_COUNT = 3  # each takes away what planned and measured pressures differ by, a few percent
MISFIT_GATE = 4.0  # chi-square per degree of freedom; a clean shift stays below 2.5
SURPRISE_GATE = 25.0  # squared distance of a shift from the running state, two degrees of freedom: 4e-6 by chance
SURPRISES_TO_YIELD = 3  # in a row: then the clutch has changed, and the running state starts afresh
EMPTY_PA = 0.30e5  # an idle clutch reads less than this: it is empty, and the reading is the sensor's zero
EMPTY_S = 0.1
SLIP_DEGREE = 5  # a shift controller's slip profile: smooth start, smooth end
PRESSURE_DEGREE = 3
FULL_WINDOW_S = 0.25  # the shortest slip window that every regular shift offers


class Estimator:
    """Estimates friction from shifts; holds nothing but the calibration."""

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration

    def estimate(self, event: ShiftEvent, belief: Belief) -> tuple[Belief, ShiftEstimate]:
        """Return the running state after a shift, and what the shift alone says about the on-coming clutch.

        The shift's own estimate uses what is known of offsets, but not the running friction. A shift that does not fit
        the model is rejected; one that fits, but contradicts the running state, is shown and kept out of it, until
        three in a row agree that the clutch has changed.
        """
        signals = gather(event, self._calibration)
        if isinstance(signals, Reason):
            return belief, without_friction(event, Status.REJECTED, signals)
        clutch = _on_coming(event.to_gear)
        belief = self._zeroed(signals, belief)
        drives = self._drives(signals, belief, event)
        window = self._window(signals, drives, clutch)
        if window is None:
            return belief, without_friction(event, Status.UNOBSERVED, Reason.NO_SLIP_WINDOW)
        balance = Balance(signals, window, drives, planned_drives(signals, drives, window), self._calibration)
        alone, misfit = self._fit(balance, belief.forget_friction(clutch, self._calibration))
        estimate = self._describe(event, signals, window, balance, alone, misfit)
        warmed = replace(
            belief,
            clutch_temperature_k=(balance.tracks[0].final_clutch_k, balance.tracks[1].final_clutch_k),
            temperature_ns=event.end_ns,
        )
        if misfit > MISFIT_GATE:
            return warmed, replace(estimate, status=Status.REJECTED, reasons=(Reason.MISFIT,), friction=None)
        return self._combined(warmed, balance, clutch, alone, estimate)

    def _fit(self, balance: Balance, prior: Belief) -> tuple[Belief, float]:
        posterior, misfit = prior, math.inf
        at = prior.mean
        for _ in range(PASS_COUNT):
            posterior, misfit = prior.updated(balance.measurement(at, prior.mean))
            at = np.concatenate((posterior.mean[: State.TORQUE_OFFSET], prior.mean[State.TORQUE_OFFSET :]))
        return posterior, misfit

    def _combined(
        self, belief: Belief, balance: Balance, clutch: int, alone: Belief, estimate: ShiftEstimate
    ) -> tuple[Belief, ShiftEstimate]:
        """Fold the shift into the running state, unless it contradicts it."""
        m = clutch - 1
        refused = list(belief.refused_counts)
        counts = list(belief.shift_counts)
        if counts[m] and _surprise(belief, alone, clutch) > SURPRISE_GATE:
            refused[m] += 1
            if refused[m] < SURPRISES_TO_YIELD:
                kept = replace(belief, refused_counts=(refused[0], refused[1]))
                return kept, replace(estimate, reasons=(Reason.NOT_UPDATED,))
            belief = belief.forget_friction(clutch, self._calibration)
            counts[m] = 0
        refused[m] = 0
        counts[m] += 1
        posterior, _ = self._fit(balance, belief.drifted())
        return (
            replace(posterior, shift_counts=(counts[0], counts[1]), refused_counts=(refused[0], refused[1])),
            estimate,
        )

    def _zeroed(self, signals: ShiftSignals, belief: Belief) -> Belief:
        """Measure the pressure sensors' zeros on the clutch that is empty before the shift."""
        std_pa = self._calibration.noise.pressure_pa
        for m, pressure in enumerate(signals.pressure):
            early = pressure.value[pressure.times_s < signals.grid_s[0] + EMPTY_S]
            if len(early) < 3 or np.max(early) > EMPTY_PA:
                continue
            row = np.zeros((1, len(State)))
            row[0, State.ZERO1 + m] = 1.0
            seen = Measurement(
                residual=np.array([np.mean(early) - belief.mean[State.ZERO1 + m]]),
                by_state=row,
                by_considered=np.zeros((1, len(Considered))),
                noise=np.array([[std_pa**2 / len(early)]]),
            )
            belief, _ = belief.updated(seen)
        return belief

    def _drives(self, signals: ShiftSignals, belief: Belief, event: ShiftEvent) -> tuple[PressureDrive, PressureDrive]:
        first, second = (
            PressureDrive(
                piston_pa=signals.pressure[m].on_grid - belief.mean[State.TOUCH1 + m] - belief.mean[State.ZERO1 + m],
                slip_rad_s=signals.slip_rad_s(m + 1),
                oil_k=signals.oil_k,
                clutch_k=self._clutch_k(m, signals.oil_k, belief, event.start_ns + signals.grid_s[0] / NS_TO_S),
            )
            for m in range(2)
        )
        return first, second

    def _clutch_k(self, m: int, oil_k: float, belief: Belief, now_ns: float) -> float:
        """Return the temperature of a pack: what it had, cooled towards the oil since."""
        if belief.clutch_temperature_k is None or now_ns < belief.temperature_ns:
            return oil_k
        thermal = self._calibration.clutches[m].thermal
        elapsed_s = (now_ns - belief.temperature_ns) * NS_TO_S
        kept = math.exp(-elapsed_s * thermal.convection_w_k / thermal.heat_capacity_j_k)
        return oil_k + (belief.clutch_temperature_k[m] - oil_k) * kept

    def _window(
        self, signals: ShiftSignals, drives: tuple[PressureDrive, PressureDrive], clutch: int
    ) -> SlipWindow | None:
        over_pa = [
            drive.piston_pa - one.touch_pressure_pa
            for drive, one in zip(drives, self._calibration.clutches, strict=True)
        ]
        on, off = clutch - 1, 2 - clutch
        return find_window(signals.grid_s, drives[on].slip_rad_s, over_pa[on], over_pa[off])

    def _describe(
        self,
        event: ShiftEvent,
        signals: ShiftSignals,
        window: SlipWindow,
        balance: Balance,
        alone: Belief,
        misfit: float,
    ) -> ShiftEstimate:
        clutch = _on_coming(event.to_gear)
        window_s = float(signals.grid_s[window.stop - 1] - signals.grid_s[window.first])
        fit = min(1.0, max(0.0, (MISFIT_GATE - misfit) / (MISFIT_GATE - 1.0)))
        mu: FloatArray = alone.mean[friction_rows(clutch)]
        return replace(
            without_friction(event, Status.VALID),
            friction=alone.friction(clutch),
            sample_count=balance.sample_count,
            window_s=window_s,
            chi_square_ratio=misfit,
            quality=fit * min(1.0, window_s / FULL_WINDOW_S) / (1.0 + event.bad_frame_count / balance.sample_count),
            clutch_temperature_k=balance.tracks[clutch - 1].final_clutch_k,
            slip_energy_j=balance.slip_energy_j(clutch, mu),
        )


def planned_drives(
    signals: ShiftSignals, measured: tuple[PressureDrive, PressureDrive], window: SlipWindow
) -> tuple[PressureDrive, PressureDrive]:
    """Return what would drive the films without sensor noise: commanded pressure and smooth slip.

    Without a command on the bus the measured pressure is smoothed, which leaves a tenth of the noise.
    """
    first, second = (
        replace(
            drive,
            piston_pa=smoothed(drive.piston_pa, window, PRESSURE_DEGREE) if expected_pa is None else expected_pa,
            slip_rad_s=smoothed(drive.slip_rad_s, window, SLIP_DEGREE),
        )
        for drive, expected_pa in zip(measured, signals.expected_pa, strict=True)
    )
    return first, second


def smoothed(values: FloatArray, window: SlipWindow, degree: int) -> FloatArray:
    """Return the values with a polynomial fit in place of those inside the window."""
    inside = slice(window.first, window.stop)
    x = np.linspace(-1.0, 1.0, window.stop - window.first)
    smooth = values.copy()
    smooth[inside] = np.polynomial.chebyshev.chebval(x, np.polynomial.chebyshev.chebfit(x, values[inside], degree))
    return smooth


def _on_coming(to_gear: int) -> int:
    """Return the clutch that carries a gear: 1 the odd ones, 2 the even ones."""
    return 1 if to_gear % 2 else 2


def _surprise(belief: Belief, alone: Belief, clutch: int) -> float:
    """Return the squared distance between a shift's own friction and the running one, common scale left out."""
    rows = friction_rows(clutch)
    spread = belief.covariance[rows, rows] + alone.covariance[rows, rows]
    step = alone.mean[rows] - belief.mean[rows]
    return float(step @ np.linalg.solve(spread, step))


def without_friction(event: ShiftEvent, status: Status, *reasons: Reason) -> ShiftEstimate:
    """Return the estimate of a shift that says nothing of friction: when and what it was, and why not."""
    return ShiftEstimate(
        number=event.number,
        from_gear=event.from_gear,
        to_gear=event.to_gear,
        clutch=_on_coming(event.to_gear),
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


def _mean(event: ShiftEvent, signal: Signal) -> float | None:
    series = event.columns.get(signal)
    return float(np.mean(series.value)) if series is not None and len(series.value) else None
