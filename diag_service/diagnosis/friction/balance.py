"""The torque impulse balance of the input side, weighted by test functions; docs/model.md section "Estimator".

The sensitivities of the residual, and so the gain of its update, come from *planned* drives that are free of sensor
noise: regressors that share noise with the residual would pull friction down by several percent. The residual itself
comes from the measured ones.

Over a slip window ``a..b`` with test functions psi_k that vanish at both ends,

    int psi (T_e - B_H w_H - T_V1 - T_V2) dt + int psi' (J_E w_E + J_H w_H) dt = sum_m int psi T_C,m dt

holds without differentiating a speed (integration by parts). Every term is linear in the samples, so the covariance
of its noise is exact; the contact torques T_C,m are linear in the friction coefficients.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, InputSide
from clutch_model.clutch import ClutchCalibration, FrictionCurve
from clutch_model.friction import contact_torques_nm, friction_law, stribeck_weights
from clutch_model.gears import both_clutches
from clutch_model.knowledge import SensorBias
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals
from diag_service.diagnosis.friction.film_track import FilmTrack, PressureDrive, integrate_film
from diag_service.diagnosis.friction.filter_state import Measurement
from diag_service.diagnosis.friction.parameters import Considered, State, friction_rows
from diag_service.diagnosis.friction.perturbations import AREA, COMMON, OFFSET, Perturbation
from diag_service.diagnosis.friction.preparation import planned_drives
from diag_service.diagnosis.friction.window import SLIP_DEGREE, SlipWindow, Weights, sines, smoothed

MAX_MOMENT_COUNT = 24  # beyond it the quadrature, not the noise, limits
SAMPLES_PER_MOMENT = 2
MIN_EXCESS = 0.05  # keeps exponents below one finite at zero slip
SIGN_WIDTH_RAD_S = 0.5  # near lock the sign of the slip fades with it, and so does its noise


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchMoments:
    """Weighted torques of one clutch: ``viscous + by_friction @ (mu_c, mu_s)``."""

    viscous: FloatArray  # (k,)
    by_friction: FloatArray  # (k, 2)

    def impulse(self, mu: FloatArray) -> FloatArray:
        """Return the weighted torque impulses [N m s], shape (k,), for ``mu = (mu_c, mu_s)``."""
        return self.viscous + self.by_friction @ mu


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
            torque_value=signals.engine_torque.to_samples(weights.value),
            engine_rate=signals.engine_speed.to_samples(weights.rate),
            hub_value=signals.hub_speed.to_samples(weights.value),
            hub_rate=signals.hub_speed.to_samples(weights.rate),
        )

    def hub(self, side: InputSide) -> FloatArray:
        """Return the weights of the hub's speed by its inertia and damping."""
        return side.hub_inertia_kg_m2 * self.hub_rate - side.hub_damping_nms_rad * self.hub_value


class Balance:
    """The weighted balance of one shift, ready to be linearised about any friction.

    Parameters
    ----------
    signals, window
        The shift and its slip window.
    measured
        What drives the film of clutch 1 and 2, pressures corrected by the offsets of the state that is passed to
        `measurement`.
    """

    def __init__(
        self,
        signals: AlignedSignals,
        window: SlipWindow,
        measured: tuple[PressureDrive, PressureDrive],
        calibration: Calibration,
    ) -> None:
        self._signals = signals
        self._measured = measured
        self._planned = planned_drives(signals, measured, window)
        self._calibration = calibration
        self._window = window
        start_s, stop_s = signals.grid_s[window.first], signals.grid_s[window.stop - 1]
        torque_s = signals.engine_torque.times_s
        self.sample_count = int(np.count_nonzero((torque_s >= start_s) & (torque_s <= stop_s)))
        count = max(3, min(MAX_MOMENT_COUNT, self.sample_count // SAMPLES_PER_MOMENT))
        self._weights = sines(signals.grid_s, window, count)
        self._spread = _Spread.of(signals, self._weights)
        self._planned_speed_rad_s = smoothed(signals.engine_speed.on_grid, window, SLIP_DEGREE)
        self._planned_torque_nm = smoothed(signals.engine_torque.on_grid, window, SLIP_DEGREE)
        self._tracks = (integrate_film(1, measured[0], calibration), integrate_film(2, measured[1], calibration))
        self._seen = self._weigh(measured, self._tracks, calibration)
        self._tracks_planned = self._film_tracks(self._planned, calibration)
        self._nominal = self._weigh(self._planned, self._tracks_planned, calibration)
        perturbations = (OFFSET, AREA[0], *(perturbation for perturbation, _ in COMMON.values()))
        self._changed = {perturbation: self._perturbed(perturbation) for perturbation in perturbations}

    def measurement(self, at: FloatArray, prior: FloatArray) -> Measurement:
        """Linearise the balance about the state ``at``, as seen from the state ``prior``; both (len(State),).

        Pressure offsets enter through their derivative only, so ``at`` must hold those of ``prior``.
        """
        signals, side, weights = self._signals, self._calibration.input_side, self._weights
        torque_nm, hub_rad_s = signals.engine_torque.on_grid, signals.hub_speed.on_grid
        bias = self._calibration.bias
        offset_nm = at[State.TORQUE_OFFSET]
        torque_nm, _ = motoring_corrected_nm(torque_nm, offset_nm, bias)
        _, motoring_nm = motoring_corrected_nm(self._planned_torque_nm, offset_nm, bias)
        mu = at[: State.MU_S2 + 1].reshape(2, 2)
        contact_nms = sum(moments.by_friction @ one for moments, one in zip(self._seen, mu, strict=True))
        engine_nms = side.engine_inertia_kg_m2 * weights.rate @ signals.engine_speed.on_grid
        known_nms = (
            side.hub_inertia_kg_m2 * weights.rate @ hub_rad_s
            - side.hub_damping_nms_rad * weights.value @ hub_rad_s
            - sum(moments.viscous for moments in self._seen)
        )
        length_s = weights.value.sum(axis=1)
        driving_nms = weights.value @ torque_nm - length_s * offset_nm
        gap_nms = driving_nms + bias.torque_gain * (engine_nms + known_nms) - contact_nms

        by_state = np.zeros((len(gap_nms), len(State)))
        by_considered = np.zeros((len(gap_nms), len(Considered)))
        by_state[:, State.TORQUE_OFFSET] = length_s
        planned_nms = side.engine_inertia_kg_m2 * weights.rate @ self._planned_speed_rad_s
        by_considered[:, Considered.TORQUE_GAIN] = -(planned_nms + known_nms)
        by_considered[:, Considered.ENGINE_INERTIA] = -bias.torque_gain * planned_nms
        by_considered[:, Considered.MOTORING_GAIN] = weights.value @ motoring_nm
        by_considered[:, Considered.TORQUE_LATENCY] = weights.rate @ torque_nm
        for m in range(2):
            plain_nms = self._nominal[m].impulse(mu[m])
            change = {one: moments[m].impulse(mu[m]) - plain_nms for one, moments in self._changed.items()}
            by_state[:, friction_rows(m + 1)] = self._nominal[m].by_friction
            by_state[:, State.TOUCH1 + m] = -change[OFFSET] / OFFSET.pressure_pa
            by_state[:, State.ZERO1 + m] = -change[OFFSET] / OFFSET.pressure_pa
            by_considered[:, Considered.PISTON_AREA1 + m] = change[AREA[0]] / AREA[1]
            for column, (perturbation, size) in COMMON.items():
                by_considered[:, column] += change[perturbation] / size
        return Measurement(
            residual=gap_nms - by_state @ (prior - at),
            by_state=by_state,
            by_considered=by_considered,
            noise=self._noise(mu),
        )

    def overlap(self, noise: FloatArray, torque_offset_nm: float) -> FloatArray:
        """Return what the derivatives by inertia and gains share with the residual, shape (len(Considered),).

        Parameters
        ----------
        noise : (k, k) array
            Covariance of the residual, as `measurement` states it.
        """
        signals, side, sensors = self._signals, self._calibration.input_side, self._calibration.noise
        bias, value, rate = self._calibration.bias, self._weights.value, self._weights.rate
        is_motoring = self._planned_torque_nm < torque_offset_nm
        by_speed = signals.engine_speed.to_samples
        by_torque = signals.engine_torque.to_samples
        speed_residual = side.engine_inertia_kg_m2 * self._spread.engine_rate
        speed_slope = side.engine_inertia_kg_m2 * by_speed(smoothed(rate, self._window, SLIP_DEGREE))
        shared = sensors.engine_speed_rad_s**2 * speed_slope @ speed_residual.T
        hub = self._spread.hub(self._calibration.input_side)
        hub_shared = sensors.hub_speed_rad_s**2 * hub @ hub.T
        motoring = smoothed(value * is_motoring / bias.motoring_gain, self._window, SLIP_DEGREE)
        overlap = np.zeros(len(Considered))
        gain = bias.torque_gain
        overlap[Considered.TORQUE_GAIN] = -gain * np.trace(np.linalg.solve(noise, shared + hub_shared))
        overlap[Considered.ENGINE_INERTIA] = -(gain**2) * np.trace(np.linalg.solve(noise, shared))
        overlap[Considered.MOTORING_GAIN] = sensors.engine_torque_nm**2 * np.trace(
            np.linalg.solve(noise, by_torque(motoring) @ self._spread.torque_value.T)
        )
        return overlap

    @property
    def final_clutch_k(self) -> tuple[float, float]:
        """Temperature of each pack at the end of the cut [K]."""
        return both_clutches(track.final_clutch_k for track in self._tracks)

    def slip_energy_j(self, clutch: int, mu: FloatArray) -> float:
        """Return the heat made in a clutch over the whole cut [J], for its ``(mu_c, mu_s)``."""
        drive, track = self._measured[clutch - 1], self._tracks[clutch - 1]
        torque_nm = contact_nm(self._calibration.clutches[clutch - 1], drive, track) @ mu + track.viscous_nm
        return float(np.sum(np.abs(torque_nm * drive.slip_rad_s)) * GRID_S)

    def _perturbed(self, perturbation: Perturbation) -> tuple[ClutchMoments, ClutchMoments]:
        """Integrate both films from the planned drives, changed a little."""
        calibration = perturbation.of_calibration(self._calibration)
        if not perturbation.moves_film:
            return self._weigh(self._planned, self._tracks_planned, calibration)
        drives = both_clutches(perturbation.of_drive(drive, self._signals.grid_s) for drive in self._planned)
        return self._weigh(drives, self._film_tracks(drives, calibration), calibration)

    def _film_tracks(
        self, drives: tuple[PressureDrive, PressureDrive], calibration: Calibration
    ) -> tuple[FilmTrack, FilmTrack]:
        """Integrate both films up to the end of the slip window: what comes after has no weight."""
        stop = self._window.stop
        return integrate_film(1, drives[0], calibration, stop), integrate_film(2, drives[1], calibration, stop)

    def _weigh(
        self, drives: tuple[PressureDrive, PressureDrive], tracks: tuple[FilmTrack, FilmTrack], calibration: Calibration
    ) -> tuple[ClutchMoments, ClutchMoments]:
        return both_clutches(
            ClutchMoments(
                viscous=self._weights.value @ tracks[m].viscous_nm,
                by_friction=self._weights.value @ contact_nm(calibration.clutches[m], drives[m], tracks[m]),
            )
            for m in range(2)
        )

    def _noise(self, mu: FloatArray) -> FloatArray:
        """Return the covariance of the residual from sensor noise, shape (k, k), every sample independent."""
        signals, side, sensors = self._signals, self._calibration.input_side, self._calibration.noise
        value, gain = self._weights.value, self._calibration.bias.torque_gain
        all_by_slip = np.zeros_like(value)
        factors = [
            sensors.engine_torque_nm * self._spread.torque_value,
            sensors.engine_speed_rad_s * gain * side.engine_inertia_kg_m2 * self._spread.engine_rate,
        ]
        for m in range(2):
            clutch = self._calibration.clutches[m]
            drive, track = self._planned[m], self._tracks_planned[m]
            torques_nm = contact_nm(clutch, drive, track)
            by_slip = value * (torques_nm[:, 1] * (mu[m, 0] - mu[m, 1]) * steepness(drive.slip_rad_s, clutch.friction))
            all_by_slip += by_slip
            factors.append(sensors.input_speed_rad_s * signals.input_speed[m].to_samples(by_slip))
            area_ratio = clutch.geometry.piston_area_m2 / clutch.geometry.lining_area_m2
            by_pressure = area_ratio * mu[m, 0] * torques_nm.sum(axis=1) / np.maximum(track.contact_pa, 1.0)
            factors.append(sensors.pressure_pa * signals.pressure[m].to_samples(value * by_pressure))
        by_hub = gain * self._spread.hub(side) - signals.hub_speed.to_samples(all_by_slip)
        factors.append(sensors.hub_speed_rad_s * by_hub)
        return np.asarray(sum(factor @ factor.T for factor in factors))


def motoring_corrected_nm(reading_nm: FloatArray, offset_nm: float, bias: SensorBias) -> tuple[FloatArray, FloatArray]:
    """Return torque readings with the gain of negative torque taken out, and their negative part; both (n,)."""
    negative_nm = np.minimum(reading_nm - offset_nm, 0.0)
    corrected_nm = negative_nm / bias.motoring_gain
    return reading_nm - negative_nm + corrected_nm, corrected_nm


def contact_nm(clutch: ClutchCalibration, drive: PressureDrive, track: FilmTrack) -> FloatArray:
    """Return the contact torque per unit of mu_c and mu_s on the grid, shape (n, 2); eqs. (6) and (8)."""
    sign = direction(drive.slip_rad_s)
    full_nm = contact_torques_nm(sign, 1.0, track.contact_pa, clutch.geometry.contact_factor_m3)
    share = stribeck_weights(drive.slip_rad_s, friction_law(clutch.friction))
    return np.column_stack((full_nm * (1.0 - share), full_nm * share))


def direction(slip_rad_s: FloatArray) -> FloatArray:
    """Return the sign of the slip, fading near zero, shape (n,)."""
    return np.clip(slip_rad_s / SIGN_WIDTH_RAD_S, -1.0, 1.0)


def steepness(slip_rad_s: FloatArray, curve: FrictionCurve) -> FloatArray:
    """Return how fast ``-log(e)`` rises with the slip [s/rad], with the slip's sign, shape (n,)."""
    excess = np.maximum(np.abs(slip_rad_s) / curve.stribeck_speed_rad_s, MIN_EXCESS)
    rise = curve.stribeck_exponent * excess ** (curve.stribeck_exponent - 1.0) / curve.stribeck_speed_rad_s
    return rise * direction(slip_rad_s)
