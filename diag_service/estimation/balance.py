"""The torque impulse balance of the input side, weighted by test functions; docs/model.md section "Estimator".

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
    signals, window, drives
        The shift, its slip window, and what drives the film of clutch 1 and 2; the drives' pressures are corrected by
        the offsets ``offset_pa`` (touch point plus zero) that the state held when they were made.
    """

    def __init__(
        self,
        signals: ShiftSignals,
        window: SlipWindow,
        drives: tuple[PressureDrive, PressureDrive],
        calibration: Calibration,
    ) -> None:
        self._signals = signals
        self._drives = drives
        self._calibration = calibration
        start_s, stop_s = signals.grid_s[window.first], signals.grid_s[window.stop - 1]
        torque_s = signals.engine_torque.times_s
        self.sample_count = int(np.count_nonzero((torque_s >= start_s) & (torque_s <= stop_s)))
        count = max(3, min(MAX_MOMENT_COUNT, self.sample_count // SAMPLES_PER_MOMENT))
        self._weights = sines(signals.grid_s, window, count)
        self._direction = tuple(np.clip(drive.slip_rad_s / SIGN_WIDTH_RAD_S, -1.0, 1.0) for drive in drives)
        self._stribeck = tuple(
            stribeck_weights(drive.slip_rad_s, clutch.friction)
            for drive, clutch in zip(drives, calibration.clutches, strict=True)
        )
        self.tracks = (follow_film(1, drives[0], calibration), follow_film(2, drives[1], calibration))
        self._moments = self._weigh(self.tracks)
        self._nudged = {nudge: self._follow(nudge) for nudge in (OFFSET, AREA, LATENCY, VISCOSITY)}

    def measurement(self, at: FloatArray, prior: FloatArray) -> Measurement:
        """Linearise the balance about the state ``at``, as seen from the state ``prior``; both (len(State),).

        Pressure offsets enter through their derivative only, so ``at`` must hold those of ``prior``.
        """
        signals, side, weights = self._signals, self._calibration.input_side, self._weights
        torque_nm, hub_rad_s = signals.engine_torque.on_grid, signals.hub_speed.on_grid
        mu = at[: State.MU_S2 + 1].reshape(2, 2)
        clutch_nms = [moments.impulse(one) for moments, one in zip(self._moments, mu, strict=True)]
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
            change = {nudge: moments[m].impulse(mu[m]) - clutch_nms[m] for nudge, moments in self._nudged.items()}
            by_state[:, friction_rows(m + 1)] = self._moments[m].by_friction
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
        torque_nm = self._contact_nm(self.tracks[clutch - 1], clutch) @ mu + self.tracks[clutch - 1].viscous_nm
        return float(np.sum(np.abs(torque_nm * self._drives[clutch - 1].slip_rad_s)) * GRID_S)

    def _follow(self, nudge: Nudge) -> tuple[ClutchMoments, ClutchMoments]:
        grid_s = self._signals.grid_s
        tracks = []
        for clutch in (1, 2):
            drive = self._drives[clutch - 1]
            later_pa = np.interp(grid_s + nudge.latency_s, grid_s, drive.piston_pa)
            piston_pa = (later_pa + nudge.pressure_pa) * (1.0 + nudge.area_ratio)
            nudged = replace(drive, piston_pa=piston_pa)
            tracks.append(follow_film(clutch, nudged, self._calibration, 1.0 + nudge.viscosity_ratio))
        return self._weigh((tracks[0], tracks[1]))

    def _weigh(self, tracks: tuple[FilmTrack, FilmTrack]) -> tuple[ClutchMoments, ClutchMoments]:
        first, second = (
            ClutchMoments(
                viscous=self._weights.value @ track.viscous_nm,
                by_friction=self._weights.value @ self._contact_nm(track, clutch),
            )
            for clutch, track in enumerate(tracks, start=1)
        )
        return first, second

    def _contact_nm(self, track: FilmTrack, clutch: int) -> FloatArray:
        """Return the contact torque per unit of mu_c and mu_s on the grid, shape (n, 2); eqs. (6) and (8)."""
        factor_m3 = self._calibration.clutches[clutch - 1].geometry.contact_factor_m3
        full_nm = factor_m3 * track.contact_pa * self._direction[clutch - 1]
        share = self._stribeck[clutch - 1]
        return np.column_stack((full_nm * (1.0 - share), full_nm * share))

    def _noise(self, mu: FloatArray) -> FloatArray:
        """Return the covariance of the residual from sensor noise, shape (k, k), every sample independent."""
        signals, side, sensors = self._signals, self._calibration.input_side, self._calibration.noise
        value, rate = self._weights.value, self._weights.rate
        hub_weight = side.hub_inertia_kg_m2 * rate - side.hub_damping_nms_rad * value
        factors = [
            sensors.engine_torque_nm * value @ signals.engine_torque.to_grid,
            sensors.engine_speed_rad_s * side.engine_inertia_kg_m2 * rate @ signals.engine_speed.to_grid,
        ]
        for m in range(2):
            clutch = self._calibration.clutches[m]
            curve = clutch.friction
            contact_nm = self._contact_nm(self.tracks[m], m + 1)
            excess = np.maximum(np.abs(self._drives[m].slip_rad_s) / curve.stribeck_speed_rad_s, 0.05)
            steepness = curve.stribeck_exponent * excess ** (curve.stribeck_exponent - 1.0) / curve.stribeck_speed_rad_s
            by_slip = value * (contact_nm[:, 1] * (mu[m, 0] - mu[m, 1]) * steepness * self._direction[m])
            hub_weight = hub_weight - by_slip
            factors.append(sensors.input_speed_rad_s * by_slip @ signals.input_speed[m].to_grid)
            by_pressure = (contact_nm.sum(axis=1) * mu[m, 0]) / np.maximum(self.tracks[m].contact_pa, 1.0)
            area_ratio = clutch.geometry.piston_area_m2 / clutch.geometry.lining_area_m2
            factors.append(sensors.pressure_pa * (value * by_pressure * area_ratio) @ signals.pressure[m].to_grid)
        factors.append(sensors.hub_speed_rad_s * hub_weight @ signals.hub_speed.to_grid)
        return np.asarray(sum(factor @ factor.T for factor in factors))


def stribeck_weights(slip_rad_s: FloatArray, curve: FrictionCurve) -> FloatArray:
    """Return the share of mu_s in the friction at each slip, shape (n,); ``e`` of docs/model.md eq. (18)."""
    excess = np.maximum(np.abs(slip_rad_s) - curve.lock_band_rad_s, 0.0) / curve.stribeck_speed_rad_s
    return np.exp(-(excess**curve.stribeck_exponent))
