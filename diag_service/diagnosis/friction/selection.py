"""Which of some events belong together, given what was known before: the selection that costs least.

An event that is left out costs as much as one that is explained badly. All events are tried first, then none at first:
two bad ones that agree hide behind each other, and each alone is missed by nobody.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.jit import array_kernel
from diag_service.diagnosis.friction.evidence import Evidence, Knowledge

OMISSION_COST: Final = 25.0  # chi-square beyond expectation that leaves an event out: of two numbers 4e-6 by chance
_LEAST_SAVING: Final = 1e-9  # of chi-square: less is rounding
_JITTER: Final = 1e-12  # of a variance: what was certain of two parameters together has an inverse too


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Some of the events, and what it costs to believe just these."""

    is_used: tuple[bool, ...]
    cost: float  # chi-square, and what leaving out costs


def omission_cost(evidence: Evidence) -> float:
    """Return what it costs to leave an event out."""
    return evidence.count + OMISSION_COST


def is_cheap(cost: float, evidences: Sequence[Evidence]) -> bool:
    """Return whether a selection costs so little that none is sought from the other end, with no event at first."""
    return cost <= sum(one.count for one in evidences) + OMISSION_COST


def selected(base: Knowledge, evidences: Sequence[Evidence]) -> Selection:
    """Return the events to believe, given what was known before them."""
    search = _search(base, evidences)
    found = _settled(search, np.ones(len(evidences), dtype=bool))
    if is_cheap(found.cost, evidences):
        return found
    return min(found, _settled(search, np.zeros(len(evidences), dtype=bool)), key=lambda one: one.cost)


def compile_selection() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    some = Evidence(matrix=np.eye(1), vector=np.zeros(1), constant=0.0, count=0)
    selected(Knowledge(mean=np.zeros(1), covariance=np.eye(1)), [some])


class _Search(NamedTuple):
    """Events and what was known before them, in standard deviations of that: in the form the kernels take."""

    precision: FloatArray  # (p, p) of what was known
    matrices: FloatArray  # (events, p, p) of information, without what was certain
    gradients: FloatArray  # (events, p)
    constants: FloatArray  # (events,) chi-square of what was known
    omissions: FloatArray  # (events,) what it costs to leave one out
    used: FloatArray  # (p, p + 1) information and gradient of what is used
    tried: FloatArray  # (p, p + 1) likewise, with one more event or without one


def _search(base: Knowledge, evidences: Sequence[Evidence]) -> _Search:
    count, number = len(base.mean), len(evidences)
    used, tried = np.empty((2, count, count + 1))
    search = _Search(
        precision=np.empty((count, count)),
        matrices=np.array([one.matrix for one in evidences]).reshape(number, count, count),
        gradients=np.array([one.vector for one in evidences]).reshape(number, count),
        constants=np.array([one.constant for one in evidences], dtype=np.float64),
        omissions=np.array([omission_cost(one) for one in evidences], dtype=np.float64),
        used=used,
        tried=tried,
    )
    std = base.std()
    _take_precision(base.covariance, std, search.precision)
    _scale(search, base.mean, std)
    return search


@array_kernel
def _take_precision(covariance: FloatArray, std: FloatArray, precision: FloatArray) -> None:
    """Fill in the inverse of a covariance in standard deviations, in which what was certain has the variance 1."""
    count = len(std)
    for j in range(count):
        for k in range(count):
            scale = std[j] * std[k]
            precision[j, k] = covariance[j, k] / scale if scale > 0.0 else 0.0
        precision[j, j] = 1.0 + _JITTER
    for j in range(count):  # by Gauss and Jordan, in place
        pivot = 1.0 / precision[j, j]
        precision[j, j] = 1.0
        for k in range(count):
            precision[j, k] *= pivot
        for i in range(count):
            if i != j:
                ratio = precision[i, j]
                precision[i, j] = 0.0
                for k in range(count):
                    precision[i, k] -= ratio * precision[j, k]


@array_kernel
def _scale(search: _Search, at: FloatArray, std: FloatArray) -> None:
    """Turn what events say about 0 into what they say about ``at``, in standard deviations."""
    matrices, gradients = search.matrices, search.gradients
    for event in range(len(matrices)):
        for j in range(len(at)):
            slope, vector = 0.0, gradients[event, j]
            for k in range(len(at)):
                slope += matrices[event, j, k] * at[k]
            for k in range(len(at)):
                matrices[event, j, k] *= std[j] * std[k]
            gradients[event, j] = (vector - slope) * std[j]
            search.constants[event] += (slope - 2.0 * vector) * at[j]


def _settled(search: _Search, is_used: BoolArray) -> Selection:
    """Return the selection in which no single event taken in or left out saves anything."""
    cost = _settle(search, is_used)
    return Selection(is_used=tuple(is_used.tolist()), cost=cost)


@array_kernel
def _settle(search: _Search, is_used: BoolArray) -> float:
    """Take in or leave out what saves most, one event at a time, until nothing does; return what it costs then."""
    spent = _gather(search, is_used)
    _copy(search.used, search.tried)
    cost = spent - _saved(search.tried)
    while True:
        best, least = -1, cost - _LEAST_SAVING
        for event in range(len(is_used)):
            sign = -1.0 if is_used[event] else 1.0
            _try(search, event, sign)
            tried = spent + sign * (search.constants[event] - search.omissions[event]) - _saved(search.tried)
            if tried < least:
                best, least = event, tried
        if best < 0:
            return cost
        is_used[best], cost = not is_used[best], least
        spent = _gather(search, is_used)


@array_kernel
def _gather(search: _Search, is_used: BoolArray) -> float:
    """Sum what is used; return its chi-square of what was known, and what leaving out the others costs."""
    count, spent = len(search.used), 0.0
    _copy(search.precision, search.used)
    search.used[:, count] = 0.0
    for event in range(len(is_used)):
        if not is_used[event]:
            spent += search.omissions[event]
            continue
        spent += search.constants[event]
        for i in range(count):
            search.used[i, count] += search.gradients[event, i]
            for k in range(count):
                search.used[i, k] += search.matrices[event, i, k]
    return spent


@array_kernel
def _copy(source: FloatArray, target: FloatArray) -> None:
    for i in range(source.shape[0]):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@array_kernel
def _try(search: _Search, event: int, sign: float) -> None:
    """Fill in what is used with one more event, or without one of them."""
    count = len(search.used)
    for i in range(count):
        search.tried[i, count] = search.used[i, count] + sign * search.gradients[event, i]
        for k in range(count):
            search.tried[i, k] = search.used[i, k] + sign * search.matrices[event, i, k]


@array_kernel
def _saved(joint: FloatArray) -> float:
    """Return ``gradient @ inv(information) @ gradient`` of both side by side, which are overwritten."""
    count, saved = len(joint), 0.0
    for j in range(count):
        pivot, gradient = joint[j, j], joint[j, count]
        saved += gradient**2 / pivot
        for i in range(j + 1, count):
            ratio = joint[j, i] / pivot
            for k in range(count + 1):  # a whole row, though half would do: by vector instructions
                joint[i, k] -= ratio * joint[j, k]
    return saved
