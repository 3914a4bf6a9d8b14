"""Parameters of a vehicle, what is known of them, and what an event says of them.

Evidence is chi-square as a function of the parameters, a paraboloid: linearised once, then kept as numbers instead of
samples. Knowledge is a mean with its covariance; docs/model.md, section "Estimator".
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, ClutchCalibration, FrictionCurve, SensorBias, Viscosity
from clutch_model.errors import CalibrationError

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
FRICTION_ROWS: Final = (slice(0, 2), slice(2, 4))  # (mu_C, mu_S) of clutch 1 and 2
REFERENCE_K = 363.15  # of a pack at work, for which friction is stated
NAMES = tuple(one.name.lower() for one in (*State, *Considered))
"""Names of all parameters, states first: the order of every joint vector."""
NUISANCE_NAMES = NAMES[FRICTION_COUNT:]
LEAST_JOINT_COUNT = 16  # names of the joint uncertainty in calibration files of the first versions


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
    if calibration.torque.is_modelled:  # a wrong scale makes all of them wrong alike
        gain, mu = STATE_COUNT + Considered.TORQUE_GAIN, prior_mean(calibration)[:FRICTION_COUNT]
        covariance[:FRICTION_COUNT, gain] = covariance[gain, :FRICTION_COUNT] = mu * covariance[gain, gain]
        covariance[:FRICTION_COUNT, :FRICTION_COUNT] += np.outer(mu, mu) * covariance[gain, gain]
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


@cache
def skew_variance(skew_s: float) -> FloatArray:
    """Return what a skew of columns adds to the variance of all parameters, shape (PARAMETER_COUNT,).

    Columns are asked one after the other: torque and pressures may be younger than the engine's speed by up to that.
    """
    added = np.zeros(PARAMETER_COUNT)
    added[[STATE_COUNT + Considered.TORQUE_LATENCY, STATE_COUNT + Considered.PRESSURE_LATENCY]] = skew_s**2 / 6.0
    return added


def displaced(calibration: Calibration, mean: FloatArray) -> Calibration:
    """Return a calibration moved to other values of all parameters.

    Parameters
    ----------
    mean : (len(NAMES),) array
        States, which a calibration holds as biases, and displacements of the considered parameters.
    """
    by, bias = mean[STATE_COUNT:].tolist(), calibration.bias
    side, oil, (first, second) = calibration.input_side, calibration.viscosity, calibration.clutches
    inertias_kg_m2 = side.input_shaft_inertias_kg_m2
    shafts_ratio = 1.0 + by[Considered.SHAFT_INERTIA]
    return replace(
        calibration,
        clutches=(
            _moved_clutch(first, by[Considered.PISTON_AREA1], by),
            _moved_clutch(second, by[Considered.PISTON_AREA2], by),
        ),
        viscosity=Viscosity(a_pa_s=oil.a_pa_s * (1.0 + by[Considered.VISCOSITY]), b_k=oil.b_k, pole_k=oil.pole_k),
        input_side=replace(
            side,
            engine_inertia_kg_m2=side.engine_inertia_kg_m2 * (1.0 + by[Considered.ENGINE_INERTIA]),
            input_shaft_inertias_kg_m2=(inertias_kg_m2[0] * shafts_ratio, inertias_kg_m2[1] * shafts_ratio),
        ),
        bias=SensorBias(
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
    # Records are made whole, not by `replace`: this runs some three times an event.
    curve = FrictionCurve(
        mu_c=curve.mu_c,
        mu_s=curve.mu_s,
        stribeck_speed_rad_s=curve.stribeck_speed_rad_s * (1.0 + by[Considered.STRIBECK_SPEED]),
        stribeck_exponent=curve.stribeck_exponent * math.exp(by[Considered.STRIBECK_EXPONENT]),
        lock_band_rad_s=curve.lock_band_rad_s,
    )
    stiffness_pa = film.contact_stiffness_pa * (1.0 + by[Considered.CONTACT_STIFFNESS])
    mobility_ratio = film.mobility_ratio * math.exp(by[Considered.FILM_MOBILITY])
    return ClutchCalibration(
        friction=curve,
        geometry=replace(geometry, piston_area_m2=geometry.piston_area_m2 * (1.0 + area_ratio)),
        piston=clutch.piston,
        film=replace(film, contact_stiffness_pa=stiffness_pa, mobility_ratio=mobility_ratio),
        thermal=clutch.thermal,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A linearised residual: ``residual = jacobian @ dx + noise`` for a displacement ``dx`` of the parameters.

    ``overlap`` is the expectation of ``jacobian.T @ inv(covariance) @ noise``: what the sensor noise that it shares
    with the residual adds to the gradient.
    """

    residual: FloatArray  # (m,)
    jacobian: FloatArray  # (m, PARAMETER_COUNT)
    covariance: FloatArray  # (m, m) of the noise
    overlap: FloatArray | None = None  # (PARAMETER_COUNT,); None: nothing is shared


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Chi-square of residuals: ``constant - 2 * vector @ x + x @ matrix @ x``."""

    matrix: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT), of information
    vector: FloatArray  # (PARAMETER_COUNT,)
    constant: float
    count: int  # residuals

    @classmethod
    def none(cls) -> Self:
        """Return what no event says."""
        empty = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
        return cls(matrix=empty, vector=np.zeros(PARAMETER_COUNT), constant=0.0, count=0)

    @classmethod
    def sum(cls, some: Sequence[Self]) -> Self:
        """Return what some events say together."""
        if not some:
            return cls.none()
        matrix, vector = some[0].matrix.copy(), some[0].vector.copy()
        constant, count = some[0].constant, some[0].count
        for one in some[1:]:
            matrix += one.matrix
            vector += one.vector
            constant += one.constant
            count += one.count
        return cls(matrix=matrix, vector=vector, constant=constant, count=count)

    @classmethod
    def of(
        cls,
        measurements: Iterable[Measurement],
        at: FloatArray,
        readings: "Evidence | None" = None,
        variance: FloatArray | None = None,
    ) -> Self:
        """Return what an event says: chi-square least over what its own parameters may differ by.

        Parameters
        ----------
        measurements
            Linearised about ``at``, shape (PARAMETER_COUNT,).
        readings
            What it says besides.
        variance
            By which each parameter of this event differs, shape (PARAMETER_COUNT,).
        """
        joint, count = np.zeros((PARAMETER_COUNT + 1, PARAMETER_COUNT + 1)), 0
        for measurement in measurements:
            sides = np.column_stack([measurement.jacobian, measurement.residual])
            joint += sides.T @ np.linalg.solve(measurement.covariance, sides)
            if measurement.overlap is not None:
                joint[:-1, -1] -= measurement.overlap
            count += len(measurement.residual)
        matrix, gradient = 0.5 * (joint + joint.T)[:-1, :-1], joint[:-1, -1]  # but for rounding it is symmetric
        vector = matrix @ at + gradient
        constant = float(joint[-1, -1] + (vector + gradient) @ at)
        if readings is not None:
            matrix += readings.matrix
            vector += readings.vector
            constant, count = constant + readings.constant, count + readings.count
        if variance is not None:
            matrix, vector, lost = _marginalised(matrix, vector, variance)
            constant -= lost
        return cls(matrix=matrix, vector=vector, constant=constant, count=count)

    @classmethod
    def of_readings(cls, rows: Sequence[int], reading: Sequence[float], variance: Sequence[float]) -> Self:
        """Return what independent readings of single parameters say, in these rows, each with a variance."""
        matrix, vector = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT)), np.zeros(PARAMETER_COUNT)
        for row, value, its_variance in zip(rows, reading, variance, strict=True):
            matrix[row, row], vector[row] = 1.0 / its_variance, value / its_variance
        constant = sum(value**2 / its_variance for value, its_variance in zip(reading, variance, strict=True))
        return cls(matrix=matrix, vector=vector, constant=constant, count=len(rows))

    def plus(self, other: Self) -> Self:
        """Return what both say."""
        return self.sum((self, other))

    def chi_square(self, at: FloatArray) -> float:
        """Return chi-square of the residuals at some parameters."""
        return self.constant + float((self.matrix @ at - 2.0 * self.vector) @ at)


@dataclass(frozen=True, slots=True, kw_only=True)
class Knowledge:
    """What is known of all parameters."""

    mean: FloatArray  # (PARAMETER_COUNT,)
    covariance: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT)

    def less_sure(self, added: FloatArray) -> Self:
        """Return the same, each parameter less certain by a variance; ``added`` has shape (PARAMETER_COUNT,)."""
        return type(self)(mean=self.mean, covariance=self.covariance + np.diag(added))

    def std(self) -> FloatArray:
        """Return the standard deviations, shape (PARAMETER_COUNT,)."""
        return np.sqrt(self.covariance.diagonal())


class Prior(NamedTuple):
    """What was known before the first event."""

    std: FloatArray  # (PARAMETER_COUNT,)
    information: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT), in these deviations

    @classmethod
    def of(cls, covariance: FloatArray) -> Self:
        std = np.sqrt(covariance.diagonal())
        std[std == 0.0] = 1.0
        return cls(std, np.linalg.pinv(covariance / np.outer(std, std), hermitian=True))

    def stated(self, whole: FloatArray, ratio: float) -> FloatArray:
        """Return a covariance of which what events tell is scaled by a ratio; docs/model.md, equation (38)."""
        kept = whole / np.maximum(self.std, np.sqrt(whole.diagonal()))  # what drifts was no better known before
        return ratio * whole + (1.0 - ratio) * (kept @ self.information @ kept.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fusion:
    """Earlier knowledge and evidence, put together."""

    knowledge: Knowledge
    chi_square: float  # least of all: of the residuals, and of the distance from what was known before
    information: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT) of the evidence

    @property
    def kept(self) -> FloatArray:
        """What is left of an error of the earlier mean, shape (PARAMETER_COUNT, PARAMETER_COUNT)."""
        return np.eye(len(self.information)) - self.knowledge.covariance @ self.information


def fuse(earlier: Knowledge, evidence: Evidence) -> Fusion:
    """Return what earlier knowledge and evidence say together; what was certain stays as it is."""
    if not evidence.count:  # then all does, to the last digit
        return Fusion(knowledge=earlier, chi_square=0.0, information=evidence.matrix)
    std = earlier.std()
    scale = np.outer(std, std)
    correlation = np.divide(earlier.covariance, scale, out=np.zeros_like(scale), where=scale > 0.0)
    looser = np.eye(len(scale)) + correlation @ (evidence.matrix * scale)
    covariance = scale * np.linalg.solve(looser, correlation)
    covariance = 0.5 * (covariance + covariance.T)
    gradient = evidence.vector - evidence.matrix @ earlier.mean
    step = covariance @ gradient
    return Fusion(
        knowledge=Knowledge(mean=earlier.mean + step, covariance=covariance),
        chi_square=evidence.chi_square(earlier.mean) - float(gradient @ step),
        information=evidence.matrix,
    )


def _marginalised(matrix: FloatArray, vector: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return information and its vector once each parameter may differ by a variance, and what chi-square loses.

    By Woodbury's identity: the information is ``inv(inv(matrix) + diag(variance))``, also where ``matrix`` has no
    inverse.
    """
    std = np.sqrt(variance)
    sides = std[:, None] * np.column_stack([matrix, vector])
    taken = sides.T @ np.linalg.solve(np.eye(len(std)) + sides[:, :-1] * std, sides)
    return matrix - 0.5 * (taken + taken.T)[:-1, :-1], vector - taken[:-1, -1], float(taken[-1, -1])
