"""The driveline of the paper's method: what it must know beyond the calibration, and one shift as a linear system.

Eqs. (1) to (3f) with both shafts in gear, in steps of a period. What is not modelled drives it as noise: the friction
torques wander, and so does the acceleration of the wheels, which are measured, so that neither road nor car nor brake
need be known.
"""

import math
import tomllib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from importlib.resources import files
from typing import Any

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import InputSide
from clutch_results.records import from_plain

SixNumbers = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Compliance:
    """A sprung and damped shaft."""

    stiffness_nm_rad: float
    damping_nms_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Shaft:
    """One input shaft: its clutch's gearbox side, its compliance, its gears."""

    clutch_inertia_kg_m2: float  # J_L
    clutch_damping_nms_rad: float  # B_L
    gear_inertia_kg_m2: float  # J_G
    gear_damping_nms_rad: float  # B_G
    stiffness_nm_rad: float  # k_si
    damping_nms_rad: float  # c_si


@dataclass(frozen=True, slots=True, kw_only=True)
class Gearbox:
    """Ratios of gears 1..6."""

    gear_ratios: SixNumbers
    final_drive_ratios: SixNumbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """Differential and half shafts."""

    inertia_kg_m2: float  # J_D
    stiffness_nm_rad: float  # k_OS
    damping_nms_rad: float  # c_OS


@dataclass(frozen=True, slots=True, kw_only=True)
class Driveline:
    """One vehicle type from flywheel to wheels."""

    flywheel: Compliance
    shafts: tuple[Shaft, Shaft]
    gearbox: Gearbox
    output: Output
    wheel_radius_m: float  # R_w, of the driven wheels

    @property
    def overall_ratios(self) -> tuple[float, ...]:
        """i(g) of gears 1..6."""
        pairs = zip(self.gearbox.gear_ratios, self.gearbox.final_drive_ratios, strict=True)
        return tuple(ratio * final for ratio, final in pairs)


def nominal_driveline() -> Driveline:
    """Return the driveline that ships with the service."""
    text = files("diag_service").joinpath("diagnosis/friction/paper/driveline.toml").read_text(encoding="utf-8")
    return from_plain(tomllib.loads(text), Driveline)


TORQUE_WANDER_NM_SQRT_S = 150.0  # friction torque: 15 N m in 10 ms, as in a handover
WHEEL_WANDER_RAD_S2_SQRT_S = 30.0  # wheel acceleration: 3 rad/s^2 in 10 ms
ENGINE_TORQUE_BAND_S = 0.01  # over which the engine torque's error is the same


class Index(IntEnum):
    """Places in the state vector."""

    ENGINE_SPEED = 0
    FLYWHEEL_TWIST = 1
    HUB_SPEED = 2
    INPUT1_SPEED = 3
    SHAFT1_TWIST = 4
    INPUT2_SPEED = 5
    SHAFT2_TWIST = 6
    DIFF_SPEED = 7
    OUTPUT_TWIST = 8
    WHEEL_SPEED = 9
    WHEEL_ACCELERATION = 10
    CLUTCH1_TORQUE = 11
    CLUTCH2_TORQUE = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivelineModel:
    """``x(n+1) = transition*x(n) + engine*T_e(n) + w``, w of covariance ``noise``; and the torques in x."""

    transition: FloatArray  # (13, 13)
    engine: FloatArray  # (13,)
    noise: FloatArray  # (13, 13)
    flywheel_nm: FloatArray  # (13,) row that reads T_FW
    shaft_nm: FloatArray  # (2, 13) rows that read T_si


def driveline_model(
    gears: tuple[int, int], period_s: float, side: InputSide, driveline: Driveline, engine_torque_std_nm: float
) -> DrivelineModel:
    """Return the model of a shift.

    Parameters
    ----------
    gears : pair of int
        Gear engaged on input shaft 1 and 2.
    """
    ratios = tuple(driveline.overall_ratios[gear - 1] for gear in gears)
    flywheel, shafts = _torque_rows(ratios, driveline)
    rate = _rates(ratios, flywheel, shafts, side, driveline)
    size = len(Index)
    diffusion = np.zeros((size, size))
    engine_std = engine_torque_std_nm / side.engine_inertia_kg_m2
    diffusion[Index.ENGINE_SPEED, Index.ENGINE_SPEED] = engine_std**2 * ENGINE_TORQUE_BAND_S
    diffusion[Index.WHEEL_ACCELERATION, Index.WHEEL_ACCELERATION] = WHEEL_WANDER_RAD_S2_SQRT_S**2
    for torque in (Index.CLUTCH1_TORQUE, Index.CLUTCH2_TORQUE):
        diffusion[torque, torque] = TORQUE_WANDER_NM_SQRT_S**2
    by_torque = np.zeros(size)
    by_torque[Index.ENGINE_SPEED] = 1.0 / side.engine_inertia_kg_m2
    transition, engine, noise = _discretised(rate, by_torque, diffusion, period_s)
    return DrivelineModel(transition=transition, engine=engine, noise=noise, flywheel_nm=flywheel, shaft_nm=shafts)


def _torque_rows(ratios: tuple[float, ...], driveline: Driveline) -> tuple[FloatArray, FloatArray]:
    flywheel = np.zeros(len(Index))
    flywheel[Index.FLYWHEEL_TWIST] = driveline.flywheel.stiffness_nm_rad
    flywheel[Index.ENGINE_SPEED] = driveline.flywheel.damping_nms_rad
    flywheel[Index.HUB_SPEED] = -driveline.flywheel.damping_nms_rad
    shafts = np.zeros((2, len(Index)))
    for m, (ratio, shaft) in enumerate(zip(ratios, driveline.shafts, strict=True)):
        shafts[m, Index.SHAFT1_TWIST + 2 * m] = shaft.stiffness_nm_rad
        shafts[m, Index.INPUT1_SPEED + 2 * m] = shaft.damping_nms_rad
        shafts[m, Index.DIFF_SPEED] = -ratio * shaft.damping_nms_rad
    return flywheel, shafts


def _rates(
    ratios: tuple[float, ...], flywheel: FloatArray, shafts: FloatArray, side: InputSide, driveline: Driveline
) -> FloatArray:
    rate = np.zeros((len(Index), len(Index)))
    rate[Index.ENGINE_SPEED] = -flywheel / side.engine_inertia_kg_m2
    rate[Index.FLYWHEEL_TWIST, [Index.ENGINE_SPEED, Index.HUB_SPEED]] = 1.0, -1.0
    rate[Index.HUB_SPEED] = flywheel / side.hub_inertia_kg_m2
    rate[Index.HUB_SPEED, Index.HUB_SPEED] -= side.hub_damping_nms_rad / side.hub_inertia_kg_m2
    diff_nm = np.zeros(len(Index))
    diff_inertia_kg_m2 = driveline.output.inertia_kg_m2
    for m, (ratio, shaft) in enumerate(zip(ratios, driveline.shafts, strict=True)):
        speed, twist, torque = Index.INPUT1_SPEED + 2 * m, Index.SHAFT1_TWIST + 2 * m, Index.CLUTCH1_TORQUE + m
        rate[Index.HUB_SPEED, torque] = -1.0 / side.hub_inertia_kg_m2
        rate[speed] = -shafts[m] / shaft.clutch_inertia_kg_m2
        rate[speed, speed] -= shaft.clutch_damping_nms_rad / shaft.clutch_inertia_kg_m2
        rate[speed, torque] += 1.0 / shaft.clutch_inertia_kg_m2
        rate[twist, [speed, Index.DIFF_SPEED]] = 1.0, -ratio
        diff_nm += ratio * shafts[m]
        diff_nm[Index.DIFF_SPEED] -= ratio**2 * shaft.gear_damping_nms_rad
        diff_inertia_kg_m2 += ratio**2 * shaft.gear_inertia_kg_m2
    output = driveline.output
    diff_nm[Index.OUTPUT_TWIST] -= output.stiffness_nm_rad
    diff_nm[Index.DIFF_SPEED] -= output.damping_nms_rad
    diff_nm[Index.WHEEL_SPEED] += output.damping_nms_rad
    rate[Index.DIFF_SPEED] = diff_nm / diff_inertia_kg_m2
    rate[Index.OUTPUT_TWIST, [Index.DIFF_SPEED, Index.WHEEL_SPEED]] = 1.0, -1.0
    rate[Index.WHEEL_SPEED, Index.WHEEL_ACCELERATION] = 1.0
    return rate


def _discretised(
    rate: FloatArray, by_torque: FloatArray, diffusion: FloatArray, period_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return transition, response to a held engine torque, and covariance of the noise (Van Loan's way)."""
    from scipy.linalg import expm  # noqa: PLC0415 - it takes a second to load

    size = len(rate)
    forced = np.zeros((size + 1, size + 1))
    forced[:size, :size], forced[:size, size] = rate, by_torque
    moved = expm(forced * period_s)
    blocks = np.block([[-rate, diffusion], [np.zeros((size, size)), rate.T]])
    spread = expm(blocks * period_s)
    noise = spread[size:, size:].T @ spread[:size, size:]
    return moved[:size, :size], moved[:size, size], 0.5 * (noise + noise.T)


TRACKING_DECADES = (-14.0, 0.0)  # from asleep to believing every sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Rated:
    """A signal and its derivative with respect to time, both (n,)."""

    value: FloatArray
    rate: FloatArray


Differentiator = Callable[[FloatArray, float], Rated]
"""Finds a signal and its rate, shape (n,) each, in even samples of it and their period [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SteadyKalman:
    """The estimator of eqs. (11) to (16) with a gain that has settled.

    ``x(n+1) = A*x(n) + L*(y(n) - C*x(n))``, x = (signal, rate): what it says at instant n knows the samples before n.
    """

    value_gain: float  # L of the signal [-]
    rate_gain_1_s: float  # L of its rate [1/s]

    def __call__(self, samples: FloatArray, period_s: float) -> Rated:
        """Return the filtered signal and rate; the filter starts at the first sample, at rest."""
        # With a settled gain it is a g-h filter: L = F*K, K = (g, h/T).
        h = self.rate_gain_1_s * period_s
        tracking = _gh_filter(period_s, self.value_gain - h, h)
        departures = (samples - samples[0]).tolist()
        states = np.empty((len(departures), 2))
        for row, departure in zip(states, departures, strict=True):
            tracking.update(departure)
            row[:] = tracking.x_prediction, tracking.dx_prediction
        return Rated(value=samples[0] + states[:, 0], rate=states[:, 1])


def _gh_filter(period_s: float, g: float, h: float) -> Any:  # noqa: ANN401 - filterpy is untyped
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it loads matplotlib, whose own dependencies are deprecated
        from filterpy.gh import GHFilter  # noqa: PLC0415 - as said above
    return GHFilter(x=0.0, dx=0.0, dt=period_s, g=g, h=h)


def steady_kalman(period_s: float, rate_variance: float, sample_variance: float) -> SteadyKalman:
    """Return the paper's filter with its steady gain, eqs. (11) to (16).

    Parameters
    ----------
    period_s : float
        T; the process noise acts through G = (T^2/2, T).
    rate_variance, sample_variance : float
        q and r, in squared units of the rate's derivative and of the samples.
    """
    from scipy.linalg import solve_discrete_are  # noqa: PLC0415 - as said above

    # Scaled states (w, T*dw/dt) and unit measurement noise: the raw equation is too ill-conditioned.
    transition = np.array([[1.0, 1.0], [0.0, 1.0]])
    drive = np.array([0.5, 1.0]) * period_s**2
    process = np.outer(drive, drive) * rate_variance / sample_variance
    observed = np.array([[1.0, 0.0]])
    covariance = solve_discrete_are(transition.T, observed.T, process, np.eye(1))
    gain = transition @ covariance @ observed.T / (observed @ covariance @ observed.T + 1.0)
    return SteadyKalman(value_gain=float(gain[0, 0]), rate_gain_1_s=float(gain[1, 0] / period_s))


def quiet_filter(period_s: float, sample_std: float, rate_std: float) -> SteadyKalman:
    """Return the fastest filter that turns white noise of ``sample_std`` into a rate no noisier than ``rate_std``.

    Raises
    ------
    ValueError
        If no filter of this period does.
    """
    from scipy.optimize import brentq  # noqa: PLC0415 - as said above

    def excess(tracking_decade: float) -> float:
        steady = tracker(tracking_decade, period_s)  # an alpha-beta tracker, whose noise of the rate is known
        beta = period_s * steady.rate_gain_1_s
        alpha = steady.value_gain - beta
        return math.sqrt(2.0 / (alpha * (4.0 - 2.0 * alpha - beta))) * beta / period_s * sample_std / rate_std - 1.0

    return tracker(float(brentq(excess, *TRACKING_DECADES)), period_s)


def tracker(decade: float, period_s: float) -> SteadyKalman:
    """Return the filter whose ``q*T^4/r``, on which alone the gain depends, is 10 to the power ``decade``."""
    return steady_kalman(period_s, 10.0**decade / period_s**4, 1.0)
