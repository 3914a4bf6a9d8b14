"""What events say of all parameters at once, and what that and earlier knowledge say together.

Evidence is chi-square as a function of the parameters, a paraboloid: linearised once, then kept as numbers instead of
samples. Knowledge is a mean with its covariance; docs/model.md, section "Estimator".
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from diag_service.diagnosis.friction.parameters import PARAMETER_COUNT

ROUNDING: Final = 1e-15  # of a variance: what is left of it beyond others' is nothing


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
        constant, count = some[0].constant, some[0].count
        for one in some[1:]:
            matrix += one.matrix
            vector += one.vector
            constant += one.constant
            count += one.count
        return cls(matrix=matrix, vector=vector, constant=constant, count=count)

    @classmethod
    def of(cls, measurements: Iterable[Measurement], at: FloatArray) -> Self:
        """Return what measurements say that were linearised about ``at``, shape (PARAMETER_COUNT,)."""
        joint, count = np.zeros((PARAMETER_COUNT + 1, PARAMETER_COUNT + 1)), 0
        for seen in measurements:
            number = len(seen.residual)
            sides = np.empty((number, number + PARAMETER_COUNT + 1))
            sides[:, :number], sides[:, number:-1], sides[:, -1] = seen.noise, seen.slope, seen.residual
            _add_information(sides, joint)
            if seen.overlap is not None:
                joint[:-1, -1] -= seen.overlap
            count += number
        matrix, vector = np.empty((PARAMETER_COUNT, PARAMETER_COUNT)), np.empty(PARAMETER_COUNT)
        return cls(matrix=matrix, vector=vector, constant=_move_to_zero(joint, at, matrix, vector), count=count)

    @classmethod
    def of_readings(cls, rows: Sequence[int], reading: Sequence[float], variance: Sequence[float]) -> Self:
        """Return what independent readings of single parameters say, in these rows, each with a variance."""
        matrix, vector = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT)), np.zeros(PARAMETER_COUNT)
        for row, value, its_variance in zip(rows, reading, variance, strict=True):
            matrix[row, row], vector[row] = 1.0 / its_variance, value / its_variance
        constant = sum(value**2 / its_variance for value, its_variance in zip(reading, variance, strict=True))
        return cls(matrix=matrix, vector=vector, constant=constant, count=len(rows))

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
        matrix, vector = self.matrix.copy(), self.vector.copy()
        lost = _loosen(variance, matrix, vector)
        return type(self)(matrix=matrix, vector=vector, constant=self.constant - lost, count=self.count)

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
    count = len(earlier.mean)
    mean, (root, turned, covariance) = np.empty(count), np.empty((3, count, count))
    work = _Work(root, turned, np.empty((count, 2 * count + 1)), np.zeros((count + 1, count + 1)))
    least = _fuse(earlier.mean, earlier.covariance, evidence.matrix, evidence.vector, work, mean, covariance)
    return Fusion(
        knowledge=Knowledge(mean=mean, covariance=covariance),
        chi_square=evidence.constant + least,
        information=evidence.matrix,
    )


@array_kernel
def _add_information(sides: FloatArray, joint: FloatArray) -> None:
    """Add ``b.T @ inv(noise) @ b`` to ``joint``, by Gauss's method.

    ``sides`` are noise and b side by side; they are overwritten. Loops over whole rows, though less would do, take half
    of the time: they become vector instructions.
    """
    count, width = sides.shape
    for j in range(count):
        pivot = sides[j, j]
        for i in range(j + 1, count):
            ratio = sides[j, i] / pivot
            for k in range(width):
                sides[i, k] -= ratio * sides[j, k]
        for i in range(count, width):
            ratio = sides[j, i] / pivot
            for k in range(width - count):
                joint[i - count, k] += ratio * sides[j, k + count]


@array_kernel
def _move_to_zero(joint: FloatArray, at: FloatArray, matrix: FloatArray, vector: FloatArray) -> float:
    """Fill in the information and its vector from those about ``at``; return chi-square where all parameters are 0."""
    count = len(at)
    constant = float(joint[count, count])
    for j in range(count):
        for k in range(j, count):
            matrix[j, k], matrix[k, j] = joint[j, k], joint[j, k]
    for j in range(count):
        slope = 0.0
        for k in range(count):
            slope += matrix[j, k] * at[k]
        vector[j] = slope + joint[j, count]
        constant += (slope + 2.0 * joint[j, count]) * at[j]
    return constant


@array_kernel
def _loosen(variance: FloatArray, matrix: FloatArray, vector: FloatArray) -> float:
    """Take away what nobody can know for the errors of parameters, one by one; return what chi-square loses."""
    count, lost = len(variance), 0.0
    for row in range(count):
        share = variance[row] / (1.0 + variance[row] * matrix[row, row])
        if share == 0.0:
            continue
        lost += share * vector[row] ** 2
        pull, own = share * vector[row], share * matrix[row, row]
        for j in range(count):
            vector[j] -= pull * matrix[row, j]
            if j != row:  # that row is wanted until the last
                taken = share * matrix[j, row]
                for k in range(count):
                    matrix[j, k] -= taken * matrix[row, k]
        for k in range(count):
            matrix[row, k] -= own * matrix[row, k]
    for j in range(count):
        for k in range(j):
            matrix[j, k] = matrix[k, j]
    return lost


class _Work(NamedTuple):
    """What `_fuse` works in; ``joint`` is zero at first."""

    root: FloatArray  # (n, n)
    turned: FloatArray  # (n, n)
    sides: FloatArray  # (n, 2 n + 1)
    joint: FloatArray  # (n + 1, n + 1)


@array_kernel
def _fuse(
    at: FloatArray, covariance: FloatArray, matrix: FloatArray, vector: FloatArray, work: _Work, mean: FloatArray,
    fused: FloatArray,
) -> float:  # fmt: skip
    """Fill in what is known with an event; return the least chi-square, less the constant."""
    count, (root, turned, sides, joint) = len(at), work
    _take_root(covariance, root, turned)
    _whiten(matrix, root, turned, sides, mean)
    moved = _add_gradient(at, matrix, vector, root, sides, mean)
    _add_information(sides, joint)
    for j in range(count):
        mean[j] = at[j] + joint[j, count]
        for k in range(j, count):
            fused[j, k], fused[k, j] = joint[j, k], joint[j, k]
    return moved - float(joint[count, count])


@array_kernel
def _take_root(covariance: FloatArray, root: FloatArray, turned: FloatArray) -> None:
    """Fill in ``root``, upper triangular, with ``covariance = root.T @ root``, and ``root.T``; certain is 0."""
    count = len(covariance)
    for j in range(count):
        for k in range(count):
            root[j, k] = covariance[j, k]
    for j in range(count):
        pivot = root[j, j]
        scale = 1.0 / math.sqrt(pivot) if pivot > ROUNDING * covariance[j, j] else 0.0
        for i in range(j + 1, count):
            ratio = root[j, i] * scale**2
            for k in range(count):
                root[i, k] -= ratio * root[j, k]
        for k in range(count):
            root[j, k] = root[j, k] * scale if k >= j else 0.0
            turned[k, j] = root[j, k]


@array_kernel
def _whiten(matrix: FloatArray, root: FloatArray, turned: FloatArray, sides: FloatArray, part: FloatArray) -> None:
    """Fill in ``1 + root @ matrix @ root.T`` and ``root``: the information in these is the new covariance."""
    count = len(root)
    for j in range(count):
        for k in range(count):
            part[k] = 0.0
            sides[j, k] = 0.0
            sides[j, count + k] = root[j, k]
        sides[j, j] = 1.0
        for k in range(j, count):
            for one in range(count):
                part[one] += root[j, k] * matrix[k, one]
        for k in range(count):
            for one in range(count):
                sides[j, one] += part[k] * turned[k, one]


@array_kernel
def _add_gradient(
    at: FloatArray, matrix: FloatArray, vector: FloatArray, root: FloatArray, sides: FloatArray, part: FloatArray
) -> float:
    """Fill in ``root @ gradient``, the last column, for the step and what it saves; return chi-square before it."""
    count, moved = len(at), 0.0
    for j in range(count):
        slope = 0.0
        for k in range(count):
            slope += matrix[j, k] * at[k]
        part[j] = vector[j] - slope
        moved += (slope - 2.0 * vector[j]) * at[j]
    for j in range(count):
        sides[j, 2 * count] = 0.0
        for k in range(j, count):
            sides[j, 2 * count] += root[j, k] * part[k]
    return moved


def compile_evidence() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    one = Measurement(residual=np.zeros(1), slope=np.zeros((1, PARAMETER_COUNT)), noise=np.eye(1))
    nowhere = np.zeros(PARAMETER_COUNT)
    fuse(Knowledge(mean=nowhere, covariance=np.eye(PARAMETER_COUNT)), Evidence.of([one], nowhere).loosened(nowhere))
