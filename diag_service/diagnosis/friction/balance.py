"""The torque impulse balance of the input side, weighted by test functions; docs/model.md section "Estimator".

Over each piece ``a..b`` of a slip window, with test functions psi_k that vanish at both ends,

    int psi (T_e - B_H w_H - T_V1 - T_V2) dt + int psi' (J_E w_E + J_H w_H) dt = sum_m int psi T_C,m dt

holds without differentiating a speed (integration by parts). Every term is linear in the samples, so the covariance
of its noise is exact; the contact torques T_C,m are linear in the friction coefficients.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, row_kernel, unchecked_kernel
from clutch_model.calibration import Calibration
from clutch_model.friction import FrictionLaw, contact_torque_nm, friction_law, row_stribeck_weight, stribeck_weight
from clutch_model.gears import both_clutches
from clutch_model.knowledge import SensorBias
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals
from diag_service.diagnosis.friction.film_track import FilmTrack, PressureDrive, integrate_films
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


class Torques(NamedTuple):
    """What both clutches carry on the rows of a window, eqs. (5), (6) and (8); each (2 clutches, ...).

    The two numbers of friction are per unit of mu_c and of mu_s.
    """

    lever_m3: FloatArray  # (2, 2, n) contact torque over its pressure
    contact_nm: FloatArray  # (2, 2, n)
    parts_nm: FloatArray  # (2, 6, n): contact, the same times the kelvins over the reference, sheared film, open drag

    @classmethod
    def of(
        cls,
        drives: tuple[PressureDrive, PressureDrive],
        tracks: tuple[FilmTrack, FilmTrack],
        calibration: Calibration,
        rows: slice,
    ) -> Self:
        """Return the torques that films and slips of both clutches make on some rows of the grid."""
        count = rows.stop - rows.start
        lever_m3, parts_nm = np.empty((2, 2, count)), np.empty((2, 6, count))
        for clutch, drive, track, levers, parts in zip(
            calibration.clutches, drives, tracks, lever_m3, parts_nm, strict=True
        ):
            own = _Rows(
                drive.slip_rad_s[rows], track.contact_pa[rows], track.clutch_k[rows], track.viscous_nm[rows],
                track.open_nm[rows],
            )  # fmt: skip
            _fill_torques(own, friction_law(clutch.friction), clutch.geometry.contact_factor_m3, levers, parts)
        return cls(lever_m3=lever_m3, contact_nm=parts_nm[:, :2], parts_nm=parts_nm)


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
        self.torques = Torques.of(measured, self.tracks, calibration, self.weights.rows)
        self._moments = weigh(self.weights, self.torques)
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


def weigh(weights: Weights, torques: Torques) -> tuple[ClutchMoments, ClutchMoments]:
    """Return the weighted torques of both clutches, on the rows of the weights."""
    sums = weights.value @ torques.parts_nm.reshape(12, -1).T
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


def compile_balance(calibration: Calibration) -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    clutch, zeros = calibration.clutches[0], np.zeros(2)
    law, factor_m3 = friction_law(clutch.friction), clutch.geometry.contact_factor_m3
    _fill_torques(_Rows(zeros, zeros, zeros, zeros, zeros), law, factor_m3, np.empty((2, 2)), np.empty((6, 2)))
    _heat_w(zeros, zeros, zeros, zeros, law, factor_m3)


class _Rows(NamedTuple):
    """Rows of what is known of a clutch, in the form the kernel takes; (n,) each."""

    slip_rad_s: FloatArray
    contact_pa: FloatArray
    clutch_k: FloatArray
    viscous_nm: FloatArray
    open_nm: FloatArray


@row_kernel
def _fill_torques(
    rows: _Rows, law: FrictionLaw, contact_factor_m3: float, lever_m3: FloatArray, parts_nm: FloatArray
) -> None:
    for row in range(len(rows.slip_rad_s)):
        weight = row_stribeck_weight(rows.slip_rad_s[row], law)
        by_mu_c_m3, by_mu_s_m3 = _levers_m3(rows.slip_rad_s[row], weight, contact_factor_m3)
        by_mu_c_nm, by_mu_s_nm = by_mu_c_m3 * rows.contact_pa[row], by_mu_s_m3 * rows.contact_pa[row]
        warm_k = rows.clutch_k[row] - REFERENCE_K
        lever_m3[0, row], lever_m3[1, row] = by_mu_c_m3, by_mu_s_m3
        parts_nm[0, row], parts_nm[1, row] = by_mu_c_nm, by_mu_s_nm
        parts_nm[2, row], parts_nm[3, row] = by_mu_c_nm * warm_k, by_mu_s_nm * warm_k
        parts_nm[4, row], parts_nm[5, row] = rows.viscous_nm[row], rows.open_nm[row]


@unchecked_kernel
def _levers_m3(slip_rad_s: float, weight: float, contact_factor_m3: float) -> tuple[float, float]:
    full_m3 = contact_torque_nm(direction(slip_rad_s), 1.0, 1.0, contact_factor_m3)
    return full_m3 * (1.0 - weight), full_m3 * weight


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
            weight = stribeck_weight(slip_rad_s[row], law)
            by_mu_c, by_mu_s = _levers_m3(slip_rad_s[row], weight, contact_factor_m3)
            torque_nm += (by_mu_c * mu[0] + by_mu_s * mu[1]) * contact_pa[row]
        total_w += abs(torque_nm * slip_rad_s[row])
    return total_w


@unchecked_kernel
def direction(slip_rad_s: float) -> float:
    """Return the sign of the slip, fading near zero."""
    return min(max(slip_rad_s / SIGN_WIDTH_RAD_S, -1.0), 1.0)
