"""The torque impulse balance of the input side, weighted by test functions; docs/model.md section "Estimator".

The sensitivities of the residual, and so the gain of its update, come from *planned* drives that are free of sensor
noise: regressors that share noise with the residual would pull friction down by several percent. The residual itself
comes from the measured ones.

Over a slip window ``a..b`` with test functions psi_k that vanish at both ends,

    int psi (T_e - B_H w_H - T_V1 - T_V2) dt + int psi' (J_E w_E + J_H w_H) dt = sum_m int psi T_C,m dt

holds without differentiating a speed (integration by parts). Every term is linear in the samples, so the covariance
of its noise is exact; the contact torques T_C,m are linear in the friction coefficients.
"""

from dataclasses import dataclass, replace

import numpy as np

from clutch_model.calibration import Calibration, FrictionCurve
from diag_service.estimation.belief import Considered, Measurement, State, friction_rows
from diag_service.estimation.film_track import FilmTrack, PressureDrive, follow_film
from diag_service.estimation.sampling import GRID_S
from diag_service.estimation.signals import ShiftSignals
from diag_service.estimation.window import SlipWindow
from diag_service.records import FloatArray

MAX_MOMENT_COUNT = 16  # beyond it the quadrature, not the noise, limits
SAMPLES_PER_MOMENT = 3
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
class Weights:
    """Sines that vanish at both ends of the window, and their derivatives, times the grid step."""

    value: FloatArray  # (k, len(grid))
    rate: FloatArray  # (k, len(grid))


def sines(grid_s: FloatArray, window: SlipWindow, count: int) -> Weights:
    """Return ``count`` sine test functions on the window; zero outside."""
    value = np.zeros((count, len(grid_s)))
    rate = np.zeros_like(value)
    inside = slice(window.first, window.stop)
    start_s, length_s = grid_s[window.first], grid_s[window.stop - 1] - grid_s[window.first]
    order = np.arange(1, count + 1)[:, None]
    angle = order * np.pi * (grid_s[inside] - start_s) / length_s
    value[:, inside] = np.sin(angle) * GRID_S
    rate[:, inside] = np.cos(angle) * order * np.pi / length_s * GRID_S
    rate[:, [window.first, window.stop - 1]] *= 0.5  # trapezoid
    return Weights(value=value, rate=rate)


@dataclass(frozen=True, slots=True, kw_only=True)
class Nudge:
    """A change of what drives the films, for derivatives."""

    pressure_pa: float = 0.0
    area_ratio: float = 0.0
    latency_s: float = 0.0
    viscosity_ratio: float = 0.0


OFFSET = Nudge(pressure_pa=2.0e3)
AREA = Nudge(area_ratio=0.01)
LATENCY = Nudge(latency_s=1e-3)
VISCOSITY = Nudge(viscosity_ratio=0.05)


class Balance:
    """The weighted balance of one shift, ready to be linearised about any friction.

    Parameters
    ----------
    signals, window
        The shift and its slip window.
    measured, planned
        What drives the film of clutch 1 and 2, as measured (pressures corrected by the offsets of the state that is
        passed to `measurement`) and as it would be without sensor noise.
    """

    def __init__(
        self,
        signals: ShiftSignals,
        window: SlipWindow,
        measured: tuple[PressureDrive, PressureDrive],
        planned: tuple[PressureDrive, PressureDrive],
        calibration: Calibration,
    ) -> None:
        self._signals = signals
        self._measured = measured
        self._planned = planned
        self._calibration = calibration
        start_s, stop_s = signals.grid_s[window.first], signals.grid_s[window.stop - 1]
        torque_s = signals.engine_torque.times_s
        self.sample_count = int(np.count_nonzero((torque_s >= start_s) & (torque_s <= stop_s)))
        count = max(3, min(MAX_MOMENT_COUNT, self.sample_count // SAMPLES_PER_MOMENT))
        self._weights = sines(signals.grid_s, window, count)
        self.tracks = (follow_film(1, measured[0], calibration), follow_film(2, measured[1], calibration))
        self._seen = self._weigh(measured, self.tracks)
        self._tracks_planned = (follow_film(1, planned[0], calibration), follow_film(2, planned[1], calibration))
        self._nominal = self._weigh(planned, self._tracks_planned)
        self._changed = {nudge: self._nudged(nudge) for nudge in (OFFSET, AREA, LATENCY, VISCOSITY)}

    def measurement(self, at: FloatArray, prior: FloatArray) -> Measurement:
        """Linearise the balance about the state ``at``, as seen from the state ``prior``; both (len(State),).

        Pressure offsets enter through their derivative only, so ``at`` must hold those of ``prior``.
        """
        signals, side, weights = self._signals, self._calibration.input_side, self._weights
        torque_nm, hub_rad_s = signals.engine_torque.on_grid, signals.hub_speed.on_grid
        mu = at[: State.MU_S2 + 1].reshape(2, 2)
        clutch_nms = [moments.impulse(one) for moments, one in zip(self._seen, mu, strict=True)]
        engine_nms = side.engine_inertia_kg_m2 * weights.rate @ signals.engine_speed.on_grid
        hub_nms = side.hub_inertia_kg_m2 * weights.rate @ hub_rad_s
        driving_nms = weights.value @ (torque_nm - side.hub_damping_nms_rad * hub_rad_s)
        length_s = weights.value.sum(axis=1)
        gap_nms = driving_nms + engine_nms + hub_nms - length_s * at[State.TORQUE_OFFSET] - sum(clutch_nms)

        by_state = np.zeros((len(gap_nms), len(State)))
        by_considered = np.zeros((len(gap_nms), len(Considered)))
        by_state[:, State.TORQUE_OFFSET] = length_s
        by_considered[:, Considered.TORQUE_GAIN] = weights.value @ torque_nm
        by_considered[:, Considered.ENGINE_INERTIA] = -engine_nms
        by_considered[:, Considered.TORQUE_LATENCY] = weights.rate @ torque_nm
        for m in range(2):
            plain_nms = self._nominal[m].impulse(mu[m])
            change = {nudge: moments[m].impulse(mu[m]) - plain_nms for nudge, moments in self._changed.items()}
            by_state[:, friction_rows(m + 1)] = self._nominal[m].by_friction
            by_state[:, State.TOUCH1 + m] = -change[OFFSET] / OFFSET.pressure_pa
            by_state[:, State.ZERO1 + m] = -change[OFFSET] / OFFSET.pressure_pa
            by_considered[:, Considered.PISTON_AREA1 + m] = change[AREA] / AREA.area_ratio
            by_considered[:, Considered.VISCOSITY] += change[VISCOSITY] / VISCOSITY.viscosity_ratio
            by_considered[:, Considered.PRESSURE_LATENCY] += change[LATENCY] / LATENCY.latency_s
        return Measurement(
            residual=gap_nms - by_state @ (prior - at),
            by_state=by_state,
            by_considered=by_considered,
            noise=self._noise(mu),
        )

    def slip_energy_j(self, clutch: int, mu: FloatArray) -> float:
        """Return the heat made in a clutch over the whole cut [J], for its ``(mu_c, mu_s)``."""
        drive, track = self._measured[clutch - 1], self.tracks[clutch - 1]
        torque_nm = self._contact_nm(clutch, drive, track) @ mu + track.viscous_nm
        return float(np.sum(np.abs(torque_nm * drive.slip_rad_s)) * GRID_S)

    def _nudged(self, nudge: Nudge) -> tuple[ClutchMoments, ClutchMoments]:
        """Follow both films from the planned drives, changed a little."""
        grid_s = self._signals.grid_s
        first, second = (
            replace(
                drive,
                piston_pa=(np.interp(grid_s + nudge.latency_s, grid_s, drive.piston_pa) + nudge.pressure_pa)
                * (1.0 + nudge.area_ratio),
            )
            for drive in self._planned
        )
        thickness = 1.0 + nudge.viscosity_ratio
        tracks = (
            follow_film(1, first, self._calibration, thickness),
            follow_film(2, second, self._calibration, thickness),
        )
        return self._weigh((first, second), tracks)

    def _weigh(
        self, drives: tuple[PressureDrive, PressureDrive], tracks: tuple[FilmTrack, FilmTrack]
    ) -> tuple[ClutchMoments, ClutchMoments]:
        first, second = (
            ClutchMoments(
                viscous=self._weights.value @ tracks[m].viscous_nm,
                by_friction=self._weights.value @ self._contact_nm(m + 1, drives[m], tracks[m]),
            )
            for m in range(2)
        )
        return first, second

    def _contact_nm(self, clutch: int, drive: PressureDrive, track: FilmTrack) -> FloatArray:
        """Return the contact torque per unit of mu_c and mu_s on the grid, shape (n, 2); eqs. (6) and (8)."""
        believed = self._calibration.clutches[clutch - 1]
        full_nm = believed.geometry.contact_factor_m3 * track.contact_pa * direction(drive.slip_rad_s)
        share = stribeck_weights(drive.slip_rad_s, believed.friction)
        return np.column_stack((full_nm * (1.0 - share), full_nm * share))

    def _noise(self, mu: FloatArray) -> FloatArray:
        """Return the covariance of the residual from sensor noise, shape (k, k), every sample independent."""
        signals, side, sensors = self._signals, self._calibration.input_side, self._calibration.noise
        value, rate = self._weights.value, self._weights.rate
        hub_weight = side.hub_inertia_kg_m2 * rate - side.hub_damping_nms_rad * value
        engine_weight = side.engine_inertia_kg_m2 * rate
        factors = [
            sensors.engine_torque_nm * signals.engine_torque.interpolation.to_samples(value),
            sensors.engine_speed_rad_s * signals.engine_speed.interpolation.to_samples(engine_weight),
        ]
        for m in range(2):
            clutch = self._calibration.clutches[m]
            drive, track = self._planned[m], self._tracks_planned[m]
            contact_nm = self._contact_nm(m + 1, drive, track)
            by_slip = value * (contact_nm[:, 1] * (mu[m, 0] - mu[m, 1]) * steepness(drive.slip_rad_s, clutch.friction))
            hub_weight = hub_weight - by_slip
            factors.append(sensors.input_speed_rad_s * signals.input_speed[m].interpolation.to_samples(by_slip))
            area_ratio = clutch.geometry.piston_area_m2 / clutch.geometry.lining_area_m2
            by_pressure = area_ratio * mu[m, 0] * contact_nm.sum(axis=1) / np.maximum(track.contact_pa, 1.0)
            factors.append(sensors.pressure_pa * signals.pressure[m].interpolation.to_samples(value * by_pressure))
        factors.append(sensors.hub_speed_rad_s * signals.hub_speed.interpolation.to_samples(hub_weight))
        return np.asarray(sum(factor @ factor.T for factor in factors))


def direction(slip_rad_s: FloatArray) -> FloatArray:
    """Return the sign of the slip, fading near zero, shape (n,)."""
    return np.clip(slip_rad_s / SIGN_WIDTH_RAD_S, -1.0, 1.0)


def stribeck_weights(slip_rad_s: FloatArray, curve: FrictionCurve) -> FloatArray:
    """Return the share of mu_s in the friction at each slip, shape (n,); ``e`` of docs/model.md eq. (18)."""
    excess = np.maximum(np.abs(slip_rad_s) - curve.lock_band_rad_s, 0.0) / curve.stribeck_speed_rad_s
    return np.exp(-(excess**curve.stribeck_exponent))


def steepness(slip_rad_s: FloatArray, curve: FrictionCurve) -> FloatArray:
    """Return how fast ``-log(e)`` rises with the slip [s/rad], with the slip's sign, shape (n,)."""
    excess = np.maximum(np.abs(slip_rad_s) / curve.stribeck_speed_rad_s, MIN_EXCESS)
    rise = curve.stribeck_exponent * excess ** (curve.stribeck_exponent - 1.0) / curve.stribeck_speed_rad_s
    return rise * direction(slip_rad_s)
