"""What events say of all parameters at once, and what that and earlier knowledge say together.

Evidence is chi-square as a function of the parameters, a paraboloid: linearised once, then kept as numbers instead of
samples. Knowledge is a mean with its covariance; docs/model.md, section "Estimator".
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from diag_service.diagnosis.friction.parameters import PARAMETER_COUNT


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A linearised residual: ``residual = slope @ dx + noise`` for a displacement ``dx`` of the parameters.

    ``overlap`` is the expectation of ``slope.T @ inv(covariance) @ noise``: what the sensor noise that a slope shares
    with the residual adds to the gradient.
    """

    residual: FloatArray  # (m,)
    slope: FloatArray  # (m, PARAMETER_COUNT)
    noise: FloatArray  # (m, m) covariance
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
        for one in some[1:]:
            matrix += one.matrix
            vector += one.vector
        return cls(
            matrix=matrix,
            vector=vector,
            constant=sum(one.constant for one in some),
            count=sum(one.count for one in some),
        )

    @classmethod
    def of(cls, measurements: Iterable[Measurement], at: FloatArray) -> Self:
        """Return what measurements say that were linearised about ``at``, shape (PARAMETER_COUNT,)."""
        joint = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT + 1))  # of information, and the gradient
        gradient, chi_square, count = joint[:, -1], 0.0, 0
        for seen in measurements:
            sides = np.empty((len(seen.residual), PARAMETER_COUNT + 1))
            sides[:, :-1], sides[:, -1] = seen.slope, seen.residual
            scaled = np.linalg.solve(seen.noise, sides)
            joint += seen.slope.T @ scaled
            if seen.overlap is not None:
                gradient -= seen.overlap
            chi_square += float(seen.residual @ scaled[:, -1])
            count += len(seen.residual)
        matrix = (joint[:, :-1] + joint[:, :-1].T) / 2.0
        return cls(
            matrix=matrix,
            vector=matrix @ at + gradient,
            constant=chi_square + float((2.0 * gradient + matrix @ at) @ at),
            count=count,
        )

    @classmethod
    def of_readings(cls, rows: Sequence[int], reading: Sequence[float], variance: Sequence[float]) -> Self:
        """Return what independent readings of single parameters say, in these rows, each with a variance."""
        matrix, vector = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT)), np.zeros(PARAMETER_COUNT)
        for row, value, its_variance in zip(rows, reading, variance, strict=True):
            matrix[row, row], vector[row] = 1.0 / its_variance, value / its_variance
        constant = sum(value**2 / its_variance for value, its_variance in zip(reading, variance, strict=True))
        return cls(matrix=matrix, vector=vector, constant=constant, count=len(rows))

    def about(self, rows: slice) -> Self:
        """Return the same of those parameters only that it says anything about."""
        return replace(self, matrix=self.matrix[rows, rows].copy(), vector=self.vector[rows])

    def plus(self, other: Self, sign: float = 1.0) -> Self:
        """Return what both say; with a ``sign`` of -1 what is left without the other."""
        return type(self)(
            matrix=self.matrix + sign * other.matrix,
            vector=self.vector + sign * other.vector,
            constant=self.constant + sign * other.constant,
            count=self.count + round(sign) * other.count,
        )

    def loosened(self, variance: FloatArray) -> Self:
        """Return what is left if each parameter of this event differs by a variance, shape (PARAMETER_COUNT,)."""
        rows = np.flatnonzero(variance)
        root, answers = np.sqrt(variance[rows]), self.matrix[:, rows]
        inner = root[:, None] * answers[rows] * root
        inner.flat[:: len(root) + 1] += 1.0
        spread = root[:, None] * np.linalg.inv(inner) * root
        taken, vector = answers @ spread, self.vector[rows]
        matrix = self.matrix - taken @ answers.T
        return type(self)(
            matrix=(matrix + matrix.T) / 2.0,
            vector=self.vector - taken @ vector,
            constant=self.constant - float(vector @ spread @ vector),
            count=self.count,
        )

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

    def about(self, rows: slice) -> Self:
        """Return what is known of some parameters."""
        return type(self)(mean=self.mean[rows], covariance=self.covariance[rows, rows].copy())

    def std(self) -> FloatArray:
        """Return the standard deviations, shape (PARAMETER_COUNT,)."""
        return np.sqrt(self.covariance.diagonal())


@dataclass(frozen=True, slots=True, kw_only=True)
class Fusion:
    """Earlier knowledge and evidence, put together."""

    knowledge: Knowledge
    chi_square: float  # least of all: of the residuals, and of the distance from what was known before
    kept: FloatArray  # (PARAMETER_COUNT, PARAMETER_COUNT) what is left of an error of the earlier mean


def fuse(earlier: Knowledge, evidence: Evidence) -> Fusion:
    """Return what earlier knowledge and evidence say together; what was certain stays as it is."""
    count = len(earlier.mean)
    scale, gradient, (spread, inner) = np.empty(count), np.empty(count), np.empty((2, count, count))
    moved = _prepare_fusion(
        earlier.mean, earlier.covariance, evidence.matrix, evidence.vector, scale, spread, inner, gradient
    )
    left = np.asarray(np.linalg.inv(inner))
    mean, (covariance, kept) = np.empty(count), np.empty((2, count, count))
    saved = _finish_fusion(left, earlier.mean, scale, spread, gradient, mean, covariance, kept)
    return Fusion(
        knowledge=Knowledge(mean=mean, covariance=covariance),
        chi_square=evidence.constant + moved - saved,
        kept=kept,
    )


@array_kernel
def _prepare_fusion(
    at: FloatArray, covariance: FloatArray, matrix: FloatArray, vector: FloatArray,
    scale: FloatArray, spread: FloatArray, inner: FloatArray, gradient: FloatArray,
) -> float:  # fmt: skip
    """Fill ``1 + spread @ matrix`` and the gradient in earlier standard deviations; return chi-square less constant.

    ``scale`` is negative for what was certain.
    """
    count, moved = len(at), 0.0
    for j in range(count):
        scale[j] = math.sqrt(covariance[j, j]) if covariance[j, j] > 0.0 else -1.0
        slope = 0.0
        for k in range(count):
            slope += matrix[j, k] * at[k]
        gradient[j] = (vector[j] - slope) * abs(scale[j])
        moved += (slope - 2.0 * vector[j]) * at[j]
    for j in range(count):
        inner[j, :] = 0.0
        inner[j, j] = 1.0
        for k in range(count):
            spread[j, k] = covariance[j, k] / abs(scale[j] * scale[k])
            share = spread[j, k] * abs(scale[k])
            for one in range(count):
                inner[j, one] += share * matrix[k, one] * abs(scale[one])
    return moved


@array_kernel
def _finish_fusion(
    left: FloatArray, at: FloatArray, scale: FloatArray, spread: FloatArray, gradient: FloatArray,
    mean: FloatArray, covariance: FloatArray, kept: FloatArray,
) -> float:  # fmt: skip
    """Fill what is known, and what is left of an earlier error; return what the step saves of chi-square."""
    count, saved = len(at), 0.0
    for j in range(count):
        covariance[j, :] = 0.0
        for k in range(count):
            for one in range(count):
                covariance[j, one] += left[j, k] * spread[k, one]
        step = 0.0
        for k in range(count):
            step += covariance[j, k] * gradient[k]
        saved += gradient[j] * step
        mean[j] = at[j] + step * max(scale[j], 0.0)
    for j in range(count):
        for k in range(j + 1):  # rounding makes nothing uncertain that was certain
            shared = 0.5 * (covariance[j, k] + covariance[k, j]) * max(scale[j], 0.0) * max(scale[k], 0.0)
            covariance[j, k], covariance[k, j] = shared, shared
        for k in range(count):
            kept[j, k] = left[j, k] * abs(scale[j] / scale[k])
    return saved


def compile_evidence() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    some = Evidence(matrix=np.eye(1), vector=np.zeros(1), constant=0.0, count=0)
    fuse(Knowledge(mean=np.zeros(1), covariance=np.eye(1)), some)
