"""The torque impulse balance of the input side, weighted by test functions; docs/model.md section "Estimator".

Over each piece ``a..b`` of a slip window, with test functions psi_k that vanish at both ends,

    int psi (T_e - B_H w_H - T_V1 - T_V2) dt + int psi' (J_E w_E + J_H w_H) dt = sum_m int psi T_C,m dt

holds without differentiating a speed (integration by parts). Every term is linear in the samples, so the covariance
of its noise is exact; the contact torques T_C,m are linear in the friction coefficients.
"""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, kernel
from clutch_model.calibration import Calibration
from clutch_model.clutch import ClutchCalibration
from clutch_model.friction import FrictionLaw, contact_torque_nm, friction_law, stribeck_weight
from clutch_model.gears import both_clutches
from clutch_model.knowledge import SensorBias
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals
from diag_service.diagnosis.friction.film_track import FilmTrack, PressureDrive, integrate_film
from diag_service.diagnosis.friction.parameters import REFERENCE_K, STATE_COUNT, Considered, State
from diag_service.diagnosis.friction.window import SlipWindow, Weights, sines, spans_of

MAX_MOMENT_COUNT = 24  # beyond it the quadrature, not the noise, limits
SAMPLES_PER_MOMENT = 2
SIGN_WIDTH_RAD_S = 0.5  # near lock the sign of the slip fades with it, and so does its noise


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchMoments:
    """Weighted torques of one clutch: ``viscous + by_friction @ (mu_c, mu_s)``."""

    viscous: FloatArray  # (k,)
    opened: FloatArray  # (k,) the part of it that an open pack drags
    by_friction: FloatArray  # (k, 2)
    by_warm_friction: FloatArray  # (k, 2) the same times the kelvins by which the pack is warmer than the reference

    def impulse(self, mu: FloatArray) -> FloatArray:
        """Return the weighted torque impulses [N m s], shape (k,), for ``mu = (mu_c, mu_s)``."""
        return self.viscous + self.by_friction @ mu


class Balance:
    """The weighted balance of one event at some parameters.

    Parameters
    ----------
    signals, window
        The event and its slip window.
    measured
        What drives the film of clutch 1 and 2, pressures corrected by the offsets of these parameters.
    calibration
        That of these parameters.
    at : (PARAMETER_COUNT,) array
        The parameters.

    Attributes
    ----------
    known_nms : (k,) array
        Impulses of the hub and of the films' shear [N m s], with the sign of the balance.
    """

    def __init__(
        self,
        signals: AlignedSignals,
        window: SlipWindow,
        measured: tuple[PressureDrive, PressureDrive],
        calibration: Calibration,
        at: FloatArray,
    ) -> None:
        self.signals = signals
        self.measured = measured
        self.calibration = calibration
        self.window = window
        self.at = at
        torque_s = signals.engine_torque.times_s
        edges = np.searchsorted(torque_s, spans_of(window.pieces, signals.grid_s))
        sample_counts = (edges[:, 1] - edges[:, 0]).tolist()
        self.sample_count = sum(
            one for one, piece in zip(sample_counts, window.pieces, strict=True) if not piece.is_rest
        )
        counts = [max(3, min(MAX_MOMENT_COUNT, one // SAMPLES_PER_MOMENT)) for one in sample_counts]
        self.weights = sines(window, counts)
        self.tracks = integrate_films(measured, calibration)
        self.contacts_nm = contacts_nm(measured, self.tracks, calibration, self.weights.rows)
        self._moments = weigh(self.weights, self.contacts_nm, self.tracks)
        side, hub_rad_s = calibration.input_side, signals.hub_speed.on_grid[self.weights.rows]
        self.known_nms = np.asarray(
            side.hub_inertia_kg_m2 * (self.weights.rate @ hub_rad_s)
            - side.hub_damping_nms_rad * (self.weights.value @ hub_rad_s)
            - sum(moments.viscous for moments in self._moments)
        )

    def residual_nms(self) -> FloatArray:
        """Return by how much the impulses do not balance [N m s], shape (k,)."""
        side, bias, weights = self.calibration.input_side, self.calibration.bias, self.weights
        offset_nm = self.at[State.TORQUE_OFFSET]
        torque_nm, _ = motoring_corrected_nm(self.signals.engine_torque.on_grid[weights.rows], offset_nm, bias)
        by_kelvin = self.at[STATE_COUNT + Considered.FRICTION_TEMPERATURE]
        contact_nms = sum(
            (moments.by_friction + by_kelvin * moments.by_warm_friction) @ mu
            for moments, mu in zip(self._moments, friction_pairs(self.at), strict=True)
        )
        engine_nms = side.engine_inertia_kg_m2 * (weights.rate @ self.signals.engine_speed.on_grid[weights.rows])
        driving_nms = weights.value @ (torque_nm - offset_nm)
        return np.asarray(driving_nms + bias.torque_gain * (engine_nms + self.known_nms) - contact_nms)

    @property
    def final_clutch_k(self) -> tuple[float, float]:
        """Temperature of each pack at the end of the cut [K]."""
        return both_clutches(track.final_clutch_k for track in self.tracks)

    def slip_energy_j(self, clutch: int, mu: FloatArray) -> float:
        """Return the heat made in a clutch over the whole cut [J], for its ``(mu_c, mu_s)``."""
        drive, track = self.measured[clutch - 1], self.tracks[clutch - 1]
        nominal = self.calibration.clutches[clutch - 1]
        law, factor_m3 = friction_law(nominal.friction), nominal.geometry.contact_factor_m3
        slip_rad_s = np.ascontiguousarray(drive.slip_rad_s)
        return GRID_S * _heat_w(slip_rad_s, track.contact_pa, track.viscous_nm, mu, law, factor_m3)


def friction_pairs(at: FloatArray) -> FloatArray:
    """Return ``(mu_c, mu_s)`` of clutch 1 and 2 among the parameters, shape (2, 2)."""
    return at[: State.MU_S2 + 1].reshape(2, 2)


def integrate_films(
    drives: tuple[PressureDrive, PressureDrive], calibration: Calibration, stop: int | None = None, step: int = 1
) -> tuple[FilmTrack, FilmTrack]:
    """Integrate both films, up to a row of the grid, in steps of some rows."""
    return both_clutches(integrate_film(m + 1, drives[m], calibration, stop, step) for m in range(2))


def contacts_nm(
    drives: tuple[PressureDrive, PressureDrive],
    tracks: tuple[FilmTrack, FilmTrack],
    calibration: Calibration,
    rows: slice,
) -> tuple[FloatArray, FloatArray]:
    """Return `contact_nm` of both clutches."""
    return both_clutches(contact_nm(calibration.clutches[m], drives[m], tracks[m], rows) for m in range(2))


def weigh(
    weights: Weights, torques_nm: tuple[FloatArray, FloatArray], tracks: tuple[FilmTrack, FilmTrack]
) -> tuple[ClutchMoments, ClutchMoments]:
    """Return the weighted torques of both clutches, of which ``torques_nm`` are the `contacts_nm` on the same rows."""
    rows, columns = weights.rows, np.empty((2, 6, weights.rows.stop - weights.rows.start))
    for own, of_friction_nm, track in zip(columns, torques_nm, tracks, strict=True):
        own[:2] = of_friction_nm.T
        own[2:4] = own[:2] * (track.clutch_k[rows] - REFERENCE_K)
        own[4], own[5] = track.viscous_nm[rows], track.open_nm[rows]
    sums = weights.value @ columns.reshape(12, -1).T
    return both_clutches(
        ClutchMoments(
            viscous=own[:, 4],
            opened=own[:, 5],
            by_friction=own[:, :2],
            by_warm_friction=own[:, 2:4],
        )
        for own in (sums[:, :6], sums[:, 6:])
    )


def motoring_corrected_nm(reading_nm: FloatArray, offset_nm: float, bias: SensorBias) -> tuple[FloatArray, FloatArray]:
    """Return torque readings with the gain of negative torque taken out, and their negative part; both (n,)."""
    negative_nm = np.minimum(reading_nm - offset_nm, 0.0)
    corrected_nm = negative_nm / bias.motoring_gain
    return reading_nm - negative_nm + corrected_nm, corrected_nm


def contact_nm(clutch: ClutchCalibration, drive: PressureDrive, track: FilmTrack, rows: slice) -> FloatArray:
    """Return the contact torque per unit of mu_c and mu_s on rows of the grid, shape (n, 2); eqs. (6) and (8)."""
    return contact_lever_m3(clutch, drive.slip_rad_s[rows]) * track.contact_pa[rows, None]


def contact_lever_m3(clutch: ClutchCalibration, slip_rad_s: FloatArray) -> FloatArray:
    """Return the contact torque per unit of contact pressure, and of mu_c and mu_s, shape (n, 2)."""
    lever_m3 = np.empty((len(slip_rad_s), 2))
    _fill_lever(
        np.ascontiguousarray(slip_rad_s), friction_law(clutch.friction), clutch.geometry.contact_factor_m3, lever_m3
    )
    return lever_m3


def compile_balance(calibration: Calibration) -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    clutch, zeros = calibration.clutches[0], np.zeros(2)
    contact_lever_m3(clutch, zeros)
    _heat_w(zeros, zeros, zeros, zeros, friction_law(clutch.friction), clutch.geometry.contact_factor_m3)


@array_kernel
def _fill_lever(slip_rad_s: FloatArray, law: FrictionLaw, contact_factor_m3: float, lever_m3: FloatArray) -> None:
    for row in range(len(slip_rad_s)):
        lever_m3[row, 0], lever_m3[row, 1] = _levers_m3(slip_rad_s[row], law, contact_factor_m3)


@kernel
def _levers_m3(slip_rad_s: float, law: FrictionLaw, contact_factor_m3: float) -> tuple[float, float]:
    full_m3, share = (
        contact_torque_nm(direction(slip_rad_s), 1.0, 1.0, contact_factor_m3),
        stribeck_weight(slip_rad_s, law),
    )
    return full_m3 * (1.0 - share), full_m3 * share


@array_kernel
def _heat_w(
    slip_rad_s: FloatArray, contact_pa: FloatArray, viscous_nm: FloatArray, mu: FloatArray, law: FrictionLaw,
    contact_factor_m3: float,
) -> float:  # fmt: skip
    """Return the sum of the heat made at each point [W]."""
    total_w = 0.0
    for row in range(len(slip_rad_s)):
        torque_nm = viscous_nm[row]
        if contact_pa[row] > 0.0:
            by_mu_c, by_mu_s = _levers_m3(slip_rad_s[row], law, contact_factor_m3)
            torque_nm += (by_mu_c * mu[0] + by_mu_s * mu[1]) * contact_pa[row]
        total_w += abs(torque_nm * slip_rad_s[row])
    return total_w


@kernel
def direction(slip_rad_s: float) -> float:
    """Return the sign of the slip, fading near zero."""
    return min(max(slip_rad_s / SIGN_WIDTH_RAD_S, -1.0), 1.0)
