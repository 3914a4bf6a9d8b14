"""How the balance of a shift answers to every parameter, and how its noise is spread; docs/model.md "Estimator".

The sensitivities, and so the gain of an update, come from *planned* drives that are free of sensor noise: regressors
that share noise with the residual would pull friction down by several percent. The residual itself comes from the
measured ones (`balance`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, InputSide
from clutch_model.clutch import FrictionCurve
from clutch_model.gears import both_clutches
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals
from diag_service.diagnosis.friction.balance import (
    Balance,
    ClutchMoments,
    contact_nm,
    direction,
    friction_pairs,
    integrate_films,
    moments_of,
    motoring_corrected_nm,
    weigh,
)
from diag_service.diagnosis.friction.evidence import Measurement
from diag_service.diagnosis.friction.film_track import COARSE, integrate_film
from diag_service.diagnosis.friction.parameters import (
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    State,
    friction_rows,
)
from diag_service.diagnosis.friction.perturbations import AREA, COMMON, OFFSET, Perturbation
from diag_service.diagnosis.friction.preparation import planned_drives
from diag_service.diagnosis.friction.window import SLIP_DEGREE, Weights

MIN_EXCESS = 0.05  # keeps exponents below one finite at zero slip
DOUBT_RATIO = 0.01  # of a clutch's torque: so far no law of friction and film holds moment by moment
DOUBT_TIME_S = 0.1  # for which what is not known is wrong one way
IDLE_RATIO = 0.1  # of the noise: a clutch that weighs less than this in the balance has no say in any derivative


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spread:
    """The weights of single samples in the weighted sums over the grid that no friction changes; each (k, samples)."""

    torque_value: FloatArray
    engine_rate: FloatArray
    hub_value: FloatArray
    hub_rate: FloatArray

    @classmethod
    def of(cls, signals: AlignedSignals, weights: Weights) -> Self:
        """Return those of a window's test functions."""
        return cls(
            torque_value=weights.value.on_samples(signals.engine_torque),
            engine_rate=weights.rate.on_samples(signals.engine_speed),
            hub_value=weights.value.on_samples(signals.hub_speed),
            hub_rate=weights.rate.on_samples(signals.hub_speed),
        )

    def hub(self, side: InputSide) -> FloatArray:
        """Return the weights of the hub's speed by its inertia and damping."""
        return side.hub_inertia_kg_m2 * self.hub_rate - side.hub_damping_nms_rad * self.hub_value


class Sensitivity:
    """The derivatives of a balance by all parameters, and the covariance of its noise.

    Attributes
    ----------
    slope : (k, PARAMETER_COUNT) array
        Of the modelled impulses, so that a residual is ``slope @ displacement + noise``.
    noises
        Covariance of the residual of each piece from sensor noise; two pieces share half a sample at most.
    overlaps
        What the derivatives of each piece by inertia and gains share with its residual, docs/model.md eq. (31); each of
        shape (PARAMETER_COUNT,).
    """

    def __init__(self, balance: Balance) -> None:
        self._balance = balance
        self._planned = planned_drives(balance.signals, balance.measured, balance.window)
        self._spread = _Spread.of(balance.signals, balance.weights)
        self._torque_nm = balance.weights.fitted(
            balance.signals.engine_torque.on_grid[balance.weights.rows], SLIP_DEGREE
        )
        planned = integrate_films(self._planned, balance.calibration, balance.window.stop, COARSE)
        self._tracks = both_clutches(  # a command shows how a clutch is filled less well than how it heats up
            replace(track, clutch_k=seen.clutch_k) for track, seen in zip(planned, balance.tracks, strict=True)
        )
        self._nominal = weigh(balance.weights, self._planned, self._tracks, balance.calibration)
        self._calibrations: dict[Perturbation, Calibration] = {}
        self._bands = balance.weights.value.bands
        self.noises = self._noises()
        self.slope = self._slope()
        self.overlaps = self._overlaps()

    def _slope(self) -> FloatArray:
        balance, at = self._balance, self._balance.at
        weights, bias = balance.weights, balance.calibration.bias
        torque_nm, motoring_nm = motoring_corrected_nm(self._torque_nm, at[State.TORQUE_OFFSET], bias)
        speed_rad_s = weights.fitted(balance.signals.engine_speed.on_grid[weights.rows], SLIP_DEGREE)
        engine_nms = balance.calibration.input_side.engine_inertia_kg_m2 * (weights.rate @ speed_rad_s)
        slope = np.zeros((self._bands[-1].stop, PARAMETER_COUNT))
        considered = slope[:, STATE_COUNT:]
        slope[:, State.TORQUE_OFFSET] = weights.value.sums()
        considered[:, Considered.TORQUE_GAIN] = -(engine_nms + balance.known_nms)
        considered[:, Considered.ENGINE_INERTIA] = -bias.torque_gain * engine_nms
        considered[:, Considered.MOTORING_GAIN] = weights.value @ motoring_nm
        considered[:, Considered.TORQUE_LATENCY] = weights.rate @ torque_nm  # smooth: noise would hold it where it is
        std_nms = np.sqrt(np.concatenate([np.diag(noise) for noise in self.noises]))
        for m, mu in enumerate(friction_pairs(at)):
            plain = self._nominal[m]
            slope[:, friction_rows(m + 1)] = plain.by_friction
            considered[:, Considered.FRICTION_TEMPERATURE] += plain.by_warm_friction @ mu
            considered[:, Considered.OPEN_DRAG] += bias.torque_gain * plain.opened
            if np.max(np.abs(plain.impulse(mu)) / std_nms) > IDLE_RATIO:
                self._add_films(slope, m, mu)
        return slope

    def _add_films(self, slope: FloatArray, m: int, mu: FloatArray) -> None:
        """Add what the film of clutch ``m + 1`` answers to everything that moves or forms it."""
        considered, plain_nms = slope[:, STATE_COUNT:], self._nominal[m].impulse(mu)

        def change(perturbation: Perturbation, size: float) -> FloatArray:
            return (self._perturbed(m, perturbation).impulse(mu) - plain_nms) / size

        by_pressure = change(OFFSET, -OFFSET.pressure_pa)
        slope[:, State.TOUCH1 + m] = by_pressure
        slope[:, State.ZERO1 + m] = by_pressure
        considered[:, Considered.PISTON_AREA1 + m] = change(*AREA)
        for column, (perturbation, size) in COMMON.items():
            considered[:, column] += change(perturbation, size)

    def _perturbed(self, m: int, perturbation: Perturbation) -> ClutchMoments:
        """Return the weighted torques of a clutch from its planned drive, changed a little."""
        balance = self._balance
        calibration = self._changed_calibration(perturbation)
        drive, track = self._planned[m], self._tracks[m]
        if perturbation.moves_film:
            drive = perturbation.of_drive(drive, balance.signals.grid_s)
            track = integrate_film(m + 1, drive, calibration, balance.window.stop, COARSE)
        return moments_of(balance.weights, m, drive, track, calibration)

    def _changed_calibration(self, perturbation: Perturbation) -> Calibration:
        """Return the changed calibration, made once for both clutches."""
        if perturbation not in self._calibrations:
            self._calibrations[perturbation] = perturbation.of_calibration(self._balance.calibration)
        return self._calibrations[perturbation]

    def _overlaps(self) -> list[FloatArray]:
        balance, signals = self._balance, self._balance.signals
        sensors, bias, weights = balance.calibration.noise, balance.calibration.bias, balance.weights
        speed_std = sensors.engine_speed_rad_s * balance.calibration.input_side.engine_inertia_kg_m2
        speed_residual = speed_std * self._spread.engine_rate
        speed_slope = speed_std * weights.rate.fitted(SLIP_DEGREE).on_samples(signals.engine_speed)
        hub = sensors.hub_speed_rad_s * self._spread.hub(balance.calibration.input_side)
        torque = sensors.engine_torque_nm * self._spread.torque_value
        is_motoring = self._torque_nm < balance.at[State.TORQUE_OFFSET]
        motoring_value = (weights.value * (is_motoring / bias.motoring_gain)).fitted(SLIP_DEGREE)
        motoring = sensors.engine_torque_nm * motoring_value.on_samples(signals.engine_torque)
        overlaps = []
        for band, noise in zip(self._bands, self.noises, strict=True):
            shared = speed_slope[band] @ speed_residual[band].T
            overlap = np.zeros(PARAMETER_COUNT)
            for parameter, covariance in {
                Considered.TORQUE_GAIN: -bias.torque_gain * (shared + hub[band] @ hub[band].T),
                Considered.ENGINE_INERTIA: -(bias.torque_gain**2) * shared,
                Considered.MOTORING_GAIN: motoring[band] @ torque[band].T,
            }.items():
                overlap[STATE_COUNT + parameter] = np.trace(np.linalg.solve(noise, covariance))
            overlaps.append(overlap)
        return overlaps

    def _noises(self) -> list[FloatArray]:
        """Return the covariance of the residual of each piece from sensor noise, every sample independent.

        Films and friction that are not known are noise of another kind, wrong one way for a while.
        """
        balance, calibration = self._balance, self._balance.calibration
        signals, side, sensors = balance.signals, calibration.input_side, calibration.noise
        value, rows, gain = balance.weights.value, balance.weights.rows, calibration.bias.torque_gain
        all_by_slip = np.zeros(rows.stop - rows.start)
        doubts = []
        factors = [
            sensors.engine_torque_nm * self._spread.torque_value,
            sensors.engine_speed_rad_s * gain * side.engine_inertia_kg_m2 * self._spread.engine_rate,
        ]
        for m, mu in enumerate(friction_pairs(balance.at)):
            clutch = calibration.clutches[m]
            drive, track = self._planned[m], self._tracks[m]
            torques_nm = contact_nm(clutch, drive, track, rows)
            by_slip = torques_nm[:, 1] * (mu[0] - mu[1]) * steepness(drive.slip_rad_s[rows], clutch.friction)
            all_by_slip += by_slip
            doubt_nm = np.hypot(balance.tracks[m].doubt_nm[rows], DOUBT_RATIO * (torques_nm @ mu))
            doubts.append(value * (gain * math.sqrt(DOUBT_TIME_S / GRID_S) * doubt_nm))
            factors.append(sensors.input_speed_rad_s * (value * by_slip).on_samples(signals.input_speed[m]))
            area_ratio = clutch.geometry.piston_area_m2 / clutch.geometry.lining_area_m2
            by_pressure = area_ratio * mu[0] * torques_nm.sum(axis=1) / np.maximum(track.contact_pa[rows], 1.0)
            factors.append(sensors.pressure_pa * (value * by_pressure).on_samples(signals.pressure[m]))
        by_hub = gain * self._spread.hub(side) - (value * all_by_slip).on_samples(signals.hub_speed)
        factors.append(sensors.hub_speed_rad_s * by_hub)
        return [
            np.asarray(
                sum(factor[band] @ factor[band].T for factor in factors)
                + sum(doubt.blocks[place] @ doubt.blocks[place].T for doubt in doubts)
            )
            for place, band in enumerate(self._bands)
        ]


def measured(balance: Balance, near: Sequence[Measurement] = ()) -> tuple[Measurement, ...]:
    """Return what each piece of a balance says, linearised; with the derivatives found near by if there are some."""
    residual = balance.residual_nms()
    bands = balance.weights.value.bands
    if [len(one.residual) for one in near] == [band.stop - band.start for band in bands]:
        return tuple(replace(one, residual=residual[band]) for one, band in zip(near, bands, strict=True))
    found = Sensitivity(balance)
    return tuple(
        Measurement(residual=residual[band], slope=found.slope[band], noise=noise, overlap=overlap)
        for band, noise, overlap in zip(bands, found.noises, found.overlaps, strict=True)
    )


def steepness(slip_rad_s: FloatArray, curve: FrictionCurve) -> FloatArray:
    """Return how fast ``-log(e)`` rises with the slip [s/rad], with the slip's sign, shape (n,)."""
    excess = np.maximum(np.abs(slip_rad_s) / curve.stribeck_speed_rad_s, MIN_EXCESS)
    rise = curve.stribeck_exponent * excess ** (curve.stribeck_exponent - 1.0) / curve.stribeck_speed_rad_s
    return rise * direction(slip_rad_s)
