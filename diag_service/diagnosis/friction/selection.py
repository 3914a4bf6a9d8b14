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
    information: FloatArray  # (p, p) for the kernels to work in
    gradient: FloatArray  # (p,) likewise


def _search(base: Knowledge, evidences: Sequence[Evidence]) -> _Search:
    std, count = base.std(), len(base.mean)
    matrices = np.array([one.matrix for one in evidences]).reshape(-1, count, count)
    vectors = np.array([one.vector for one in evidences]).reshape(-1, count)
    slopes = matrices @ base.mean
    spread = base.covariance / np.outer(scale := np.where(std > 0.0, std, 1.0), scale)
    spread.flat[:: count + 1] = 1.0 + _JITTER
    return _Search(
        precision=np.linalg.inv(spread),
        matrices=matrices * np.outer(std, std),
        gradients=(vectors - slopes) * std,
        constants=np.array([one.constant for one in evidences]) + (slopes - 2.0 * vectors) @ base.mean,
        omissions=np.array([omission_cost(one) for one in evidences]),
        information=np.empty((count, count)),
        gradient=np.empty(count),
    )


def _settled(search: _Search, is_used: BoolArray) -> Selection:
    """Return the selection in which no single event taken in or left out saves anything."""
    cost = _settle(search, is_used)
    return Selection(is_used=tuple(is_used.tolist()), cost=cost)


@array_kernel
def _settle(search: _Search, is_used: BoolArray) -> float:
    """Take in or leave out what saves most, one event at a time, until nothing does; return what it costs then."""
    cost = _cost(search, is_used)
    while True:
        best, least = -1, cost - _LEAST_SAVING
        for event in range(len(is_used)):
            is_used[event] = not is_used[event]
            tried = _cost(search, is_used)
            is_used[event] = not is_used[event]
            if tried < least:
                best, least = event, tried
        if best < 0:
            return cost
        is_used[best], cost = not is_used[best], least


@array_kernel
def _cost(search: _Search, is_used: BoolArray) -> float:
    """Return chi-square where the used events and what was known meet, and what leaving out the others costs."""
    _start(search.information, search.gradient, search.precision)
    cost = 0.0
    for event in range(len(is_used)):
        if is_used[event]:
            cost += search.constants[event]
            _add(search.information, search.gradient, search.matrices, search.gradients, event)
        else:
            cost += search.omissions[event]
    return cost - _saved(search.information, search.gradient)


@array_kernel
def _start(information: FloatArray, gradient: FloatArray, precision: FloatArray) -> None:
    for i in range(len(gradient)):
        gradient[i] = 0.0
        for k in range(i, len(gradient)):  # of what is symmetric the upper half is enough
            information[i, k] = precision[i, k]


@array_kernel
def _add(
    information: FloatArray, gradient: FloatArray, matrices: FloatArray, gradients: FloatArray, event: int
) -> None:
    for i in range(len(gradient)):
        gradient[i] += gradients[event, i]
        for k in range(i, len(gradient)):
            information[i, k] += matrices[event, i, k]


@array_kernel
def _saved(information: FloatArray, gradient: FloatArray) -> float:
    """Return ``gradient @ inv(information) @ gradient`` by Cholesky's method; both are overwritten."""
    count, saved = len(gradient), 0.0
    for j in range(count):
        pivot = information[j, j]
        step = gradient[j] / pivot
        saved += gradient[j] * step
        for i in range(j + 1, count):
            gradient[i] -= information[j, i] * step
            ratio = information[j, i] / pivot
            for k in range(i, count):
                information[i, k] -= ratio * information[j, k]
    return saved
