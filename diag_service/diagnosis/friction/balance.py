"""The torque impulse balance of the input side, weighted by test functions; docs/model.md section "Estimator".

Over each piece ``a..b`` of a slip window, with test functions psi_k that vanish at both ends,

    int psi (T_e - B_H w_H - T_V1 - T_V2) dt + int psi' (J_E w_E + J_H w_H) dt = sum_m int psi T_C,m dt

holds without differentiating a speed (integration by parts). Every term is linear in the samples, so the covariance
of its noise is exact; the contact torques T_C,m are linear in the friction coefficients.
"""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel
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

    @property
    def known_nms(self) -> FloatArray:
        """Impulses of the hub and of the films' shear, with the sign of the balance, shape (k,)."""
        side, weights, hub_rad_s = (
            self.calibration.input_side,
            self.weights,
            self.signals.hub_speed.on_grid[self.weights.rows],
        )
        return np.asarray(
            side.hub_inertia_kg_m2 * (weights.rate @ hub_rad_s)
            - side.hub_damping_nms_rad * (weights.value @ hub_rad_s)
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
        torque_nm = contact_nm(self.calibration.clutches[clutch - 1], drive, track, slice(None)) @ mu + track.viscous_nm
        return float(np.sum(np.abs(torque_nm * drive.slip_rad_s)) * GRID_S)


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
    return both_clutches(_moments_of(weights, *pair) for pair in zip(torques_nm, tracks, strict=True))


def _moments_of(weights: Weights, torques_nm: FloatArray, track: FilmTrack) -> ClutchMoments:
    rows = weights.rows
    weighted = weights.value @ np.column_stack(
        (
            torques_nm,
            torques_nm * (track.clutch_k[rows] - REFERENCE_K)[:, None],
            track.viscous_nm[rows],
            track.open_nm[rows],
        )
    )
    return ClutchMoments(
        viscous=weighted[:, 4],
        opened=weighted[:, 5],
        by_friction=weighted[:, :2],
        by_warm_friction=weighted[:, 2:4],
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
    contact_lever_m3(calibration.clutches[0], np.zeros(2))


@kernel
def _fill_lever(slip_rad_s: FloatArray, law: FrictionLaw, contact_factor_m3: float, lever_m3: FloatArray) -> None:
    for row in range(len(slip_rad_s)):
        slip = slip_rad_s[row]
        way = min(max(slip / SIGN_WIDTH_RAD_S, -1.0), 1.0)
        full_m3, share = contact_torque_nm(way, 1.0, 1.0, contact_factor_m3), stribeck_weight(slip, law)
        lever_m3[row, 0] = full_m3 * (1.0 - share)
        lever_m3[row, 1] = full_m3 * share


def direction(slip_rad_s: FloatArray) -> FloatArray:
    """Return the sign of the slip, fading near zero, shape (n,)."""
    return np.clip(slip_rad_s / SIGN_WIDTH_RAD_S, -1.0, 1.0)
