"""Which of some events belong together, given what was known before: the selection that costs least.

An event that is left out costs as much as one that is explained badly. All events are tried first, then none at first:
two bad ones that agree hide behind each other, and each alone is missed by nobody.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from diag_service.diagnosis.friction.evidence import Evidence, Knowledge

OMISSION_COST: Final = 25.0  # chi-square beyond expectation that leaves an event out: of two numbers 4e-6 by chance
_LEAST_SAVING: Final = 1e-9  # of chi-square: less is rounding


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Some of the events, and what it costs to believe just these."""

    is_used: tuple[bool, ...]
    cost: float  # chi-square, and what leaving out costs


def omission_cost(evidence: Evidence) -> float:
    """Return what it costs to leave an event out."""
    return evidence.count + OMISSION_COST


def selected(base: Knowledge, evidences: Sequence[Evidence]) -> Selection:
    """Return the events to believe, given what was known before them."""
    search = _Search(base, evidences)
    found = search.settled(np.ones(len(evidences), dtype=bool))
    if found.cost <= sum(one.count for one in evidences) + OMISSION_COST:
        return found
    return min(found, search.settled(np.zeros(len(evidences), dtype=bool)), key=lambda one: one.cost)


class _Search:
    """Costs of selections, many at once; everything in standard deviations of what was known before."""

    def __init__(self, base: Knowledge, evidences: Sequence[Evidence]) -> None:
        std = base.std()
        scale = np.where(std > 0.0, std, 1.0)
        count, units = len(std), np.outer(scale, scale)
        matrices = np.array([one.matrix for one in evidences]).reshape(-1, count, count)
        vectors = np.array([one.vector for one in evidences]).reshape(-1, count)
        self._spread = base.covariance / units
        self._matrices = (matrices * units).reshape(-1, count * count)
        self._gradients = (vectors - matrices @ base.mean) * scale
        self._constants = np.array([one.chi_square(base.mean) for one in evidences])
        self._omissions = np.array([omission_cost(one) for one in evidences])

    def costs(self, used: BoolArray) -> FloatArray:
        """Return what selections cost, shape (m,), one in each row of ``used``, shape (m, events)."""
        weights = used.astype(np.float64)
        count = len(self._spread)
        matrices = (weights @ self._matrices).reshape(-1, count, count)
        gradients = weights @ self._gradients
        sides = (gradients @ self._spread)[:, :, None]
        steps = np.linalg.solve(np.eye(count) + self._spread @ matrices, sides)[:, :, 0]
        saved = np.sum(gradients * steps, axis=1)
        return np.asarray(weights @ self._constants - saved + (1.0 - weights) @ self._omissions)

    def settled(self, used: BoolArray) -> Selection:
        """Return the selection in which no single event taken in or left out saves anything."""
        flips = np.eye(len(used), dtype=bool)
        while True:
            tried = np.vstack((used, used ^ flips))
            costs = self.costs(tried)
            best = int(np.argmin(costs))
            if costs[best] >= costs[0] - _LEAST_SAVING:
                return Selection(is_used=tuple(used.tolist()), cost=float(costs[0]))
            used = tried[best]
