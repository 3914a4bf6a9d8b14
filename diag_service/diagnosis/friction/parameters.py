"""What a shift depends on: the parameters that the estimator estimates and those that it only considers."""

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.clutch import ClutchCalibration
from clutch_model.errors import CalibrationError
from clutch_model.gears import both_clutches

FRICTION_PRIOR_STD = 0.05  # a third of any lining's friction: weak against a single shift


class State(IntEnum):
    """Index of each estimated parameter; friction is multiplied by the gain of the torque reading."""

    MU_C1 = 0
    MU_S1 = 1
    MU_C2 = 2
    MU_S2 = 3
    TORQUE_OFFSET = 4  # reading minus truth [Nm]
    TOUCH1 = 5  # touch pressure minus calibration [Pa]
    TOUCH2 = 6
    ZERO1 = 7  # pressure reading minus truth [Pa]
    ZERO2 = 8


class Considered(IntEnum):
    """Index of each parameter that is carried, but not estimated shift by shift; relative to the calibration."""

    TORQUE_GAIN = 0  # ratio
    ENGINE_INERTIA = 1  # ratio
    PISTON_AREA1 = 2  # ratio
    PISTON_AREA2 = 3
    VISCOSITY = 4  # ratio
    TORQUE_LATENCY = 5  # [s]
    PRESSURE_LATENCY = 6  # [s]
    MOTORING_GAIN = 7  # ratio
    STRIBECK_SPEED = 8  # ratio, both clutches
    CONTACT_STIFFNESS = 9  # ratio, both clutches
    SHAFT_INERTIA = 10  # ratio, both input shafts in neutral
    FILM_MOBILITY = 11  # natural logarithm of a ratio, both clutches
    STRIBECK_EXPONENT = 12  # natural logarithm of a ratio, both clutches
    FRICTION_TEMPERATURE = 13  # ratio per kelvin, both clutches
    OPEN_DRAG = 14  # natural logarithm of a ratio, both clutches


STATE_COUNT = len(State)
PARAMETER_COUNT = STATE_COUNT + len(Considered)
FRICTION_COUNT = 4
REFERENCE_K = 363.15  # of a pack at work, for which friction is stated
NAMES = tuple(one.name.lower() for one in (*State, *Considered))
"""Names of all parameters, states first: the order of every joint vector."""
NUISANCE_NAMES = NAMES[FRICTION_COUNT:]
LEAST_JOINT_COUNT = 16  # names of the joint uncertainty in calibration files of the first versions


def friction_rows(clutch: int) -> slice:
    """Return the state rows (mu_C, mu_S) of clutch 1 or 2."""
    return slice(2 * clutch - 2, 2 * clutch)


def open_drag_ratio(at: FloatArray) -> float:
    """Return the drag of an open pack over what is believed; ``at`` are all parameters, shape (len(NAMES),)."""
    return math.exp(at[STATE_COUNT + Considered.OPEN_DRAG])


def prior_mean(calibration: Calibration) -> FloatArray:
    """Return the states before any shift, shape (len(State),)."""
    bias = calibration.bias
    mean = np.zeros(STATE_COUNT)
    curves = [clutch.friction for clutch in calibration.clutches]
    mean[:FRICTION_COUNT] = [bias.torque_gain * value for curve in curves for value in (curve.mu_c, curve.mu_s)]
    mean[State.TORQUE_OFFSET] = bias.torque_offset_nm
    mean[State.TOUCH1], mean[State.TOUCH2] = bias.touch_offsets_pa
    mean[State.ZERO1], mean[State.ZERO2] = bias.pressure_zeros_pa
    return mean


def prior_covariance(calibration: Calibration) -> FloatArray:
    """Return the covariance of all parameters before any shift, shape (len(NAMES), len(NAMES)).

    Raises
    ------
    CalibrationError
        If the joint uncertainty of the calibration is not that of these parameters.
    """
    covariance = np.zeros((len(NAMES), len(NAMES)))
    covariance[:FRICTION_COUNT, :FRICTION_COUNT] = np.eye(FRICTION_COUNT) * FRICTION_PRIOR_STD**2
    covariance[FRICTION_COUNT:, FRICTION_COUNT:] = _nuisance_covariance(calibration)
    return covariance


def _nuisance_covariance(calibration: Calibration) -> FloatArray:
    joint = calibration.joint
    if joint is None:
        return np.diag(np.square(type_std(calibration)))
    if joint.names != NUISANCE_NAMES[: len(joint.names)] or len(joint.names) < LEAST_JOINT_COUNT:
        raise CalibrationError(f"joint.names must be {', '.join(NUISANCE_NAMES)}")
    count, std = len(joint.names), np.array(joint.std)
    covariance = np.diag(np.square(type_std(calibration)))  # of what earlier programs did not calibrate
    covariance[:count, :count] = std[:, None] * np.array(joint.correlation) * std
    if np.linalg.eigvalsh(np.array(joint.correlation))[0] < -1e-9:
        raise CalibrationError("joint.correlation is not positive")
    return covariance


def type_std(calibration: Calibration) -> list[float]:
    """Return by how much vehicles of the type differ in each of ``NUISANCE_NAMES``."""
    scatter = calibration.uncertainty
    return [
        scatter.torque_offset_nm,
        scatter.touch_pressure_pa,
        scatter.touch_pressure_pa,
        scatter.pressure_zero_pa,
        scatter.pressure_zero_pa,
        scatter.torque_gain_ratio,
        scatter.engine_inertia_ratio,
        scatter.piston_area_ratio,
        scatter.piston_area_ratio,
        scatter.viscosity_ratio,
        scatter.torque_latency_s,
        scatter.pressure_latency_s,
        scatter.motoring_gain_ratio,
        scatter.stribeck_speed_ratio,
        scatter.contact_stiffness_ratio,
        scatter.input_shaft_inertia_ratio,
        scatter.film_mobility_log,
        scatter.stribeck_exponent_log,
        scatter.friction_temperature_1_k,
        scatter.open_drag_log,
    ]


def displaced(calibration: Calibration, mean: FloatArray) -> Calibration:
    """Return a calibration moved to other values of all parameters.

    Parameters
    ----------
    mean : (len(NAMES),) array
        States, which a calibration holds as biases, and displacements of the considered parameters.
    """
    by, bias = mean[STATE_COUNT:].tolist(), calibration.bias
    side, oil, (first, second) = calibration.input_side, calibration.viscosity, calibration.clutches
    shafts_ratio = 1.0 + by[Considered.SHAFT_INERTIA]
    return replace(
        calibration,
        clutches=(
            _moved_clutch(first, by[Considered.PISTON_AREA1], by),
            _moved_clutch(second, by[Considered.PISTON_AREA2], by),
        ),
        viscosity=replace(oil, a_pa_s=oil.a_pa_s * (1.0 + by[Considered.VISCOSITY])),
        input_side=replace(
            side,
            engine_inertia_kg_m2=side.engine_inertia_kg_m2 * (1.0 + by[Considered.ENGINE_INERTIA]),
            input_shaft_inertias_kg_m2=both_clutches(one * shafts_ratio for one in side.input_shaft_inertias_kg_m2),
        ),
        bias=replace(
            bias,
            torque_gain=bias.torque_gain + by[Considered.TORQUE_GAIN],
            motoring_gain=bias.motoring_gain + by[Considered.MOTORING_GAIN],
            torque_latency_s=bias.torque_latency_s + by[Considered.TORQUE_LATENCY],
            pressure_latency_s=bias.pressure_latency_s + by[Considered.PRESSURE_LATENCY],
            torque_offset_nm=float(mean[State.TORQUE_OFFSET]),
            touch_offsets_pa=(float(mean[State.TOUCH1]), float(mean[State.TOUCH2])),
            pressure_zeros_pa=(float(mean[State.ZERO1]), float(mean[State.ZERO2])),
        ),
    )


def _moved_clutch(clutch: ClutchCalibration, area_ratio: float, by: Sequence[float]) -> ClutchCalibration:
    """Return a clutch with another piston and lining; its springs stay, so its touch pressure moves with the area."""
    curve, film, geometry = clutch.friction, clutch.film, clutch.geometry
    width_rad_s = curve.stribeck_speed_rad_s * (1.0 + by[Considered.STRIBECK_SPEED])
    exponent = curve.stribeck_exponent * math.exp(by[Considered.STRIBECK_EXPONENT])
    stiffness_pa = film.contact_stiffness_pa * (1.0 + by[Considered.CONTACT_STIFFNESS])
    mobility_ratio = film.mobility_ratio * math.exp(by[Considered.FILM_MOBILITY])
    return replace(
        clutch,
        geometry=replace(geometry, piston_area_m2=geometry.piston_area_m2 * (1.0 + area_ratio)),
        friction=replace(curve, stribeck_speed_rad_s=width_rad_s, stribeck_exponent=exponent),
        film=replace(film, contact_stiffness_pa=stiffness_pa, mobility_ratio=mobility_ratio),
    )
