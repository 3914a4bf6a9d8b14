"""How lives of fluids bend: how often ageing becomes faster or slower before the end, and by how much.

Each past life is foretold at some of its ages as if nothing bent. What truly came says how likely each bend was: the
shares of bends that explain all lives best, found by expectation and maximization (Dempster, Laird, Rubin 1977).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis.assumptions import FUTURE_BENDS
from diag_service.diagnosis.prognosis.passage import Passage

FACTORS: Final = (1.0, 0.6, 0.85, 1.2, 1.5, 2.0, 2.5, 3.3, 4.5)  # of the rate, the first of them no bend
ASSUMED_LIVES: Final = 4.0  # that the assumed bends count as
SHARED_LIVES: Final = 30.0  # that the bends of all types count as, for one type
_BLUR: Final = 0.08  # of what was left: how exactly the end of a past life is known
_LEAST: Final = 1e-4  # probability of any end: no bend is impossible
_ROUNDS: Final = 200

Bends = Mapping[float, float]  # factor of the rate: chance that it comes before the end


@dataclass(frozen=True, slots=True, kw_only=True)
class Hindsight:
    """What would have been foretold of a past life at one of its ages, and what came."""

    share: float  # of the life that was over
    left_m: float  # that it truly lasted from then on, or was followed
    has_ended: bool
    passage: Passage  # if nothing bent


def bends_of(groups: Mapping[str, Sequence[Sequence[Hindsight]]]) -> dict[str, Bends]:
    """Return the bends of each type from the looks at its lives; what they share comes from all of them."""
    likelihoods = {name: _likelihoods(lives) for name, lives in groups.items()}
    assumed = np.array([1.0 - sum(FUTURE_BENDS.values()), *(FUTURE_BENDS.get(one, 0.0) for one in FACTORS[1:])])
    every = np.concatenate([rows for rows, _ in likelihoods.values()])
    weight = np.concatenate([weight for _, weight in likelihoods.values()])
    shared = _shares(every, weight, ASSUMED_LIVES * assumed)
    found: dict[str, Bends] = {}
    for name, (rows, own) in likelihoods.items():
        shares = _shares(rows, own, SHARED_LIVES * shared)
        found[name] = dict(zip(FACTORS[1:], shares[1:].tolist(), strict=True))
    return found


def _likelihoods(lives: Sequence[Sequence[Hindsight]]) -> tuple[FloatArray, FloatArray]:
    """Return how likely each bend makes what came of each look, and the weight of each; a life counts as one."""
    rows = [_likelihood(look) for life in lives for look in life]
    weight = [1.0 / len(life) for life in lives for _ in life]
    return np.array(rows).reshape(-1, len(FACTORS)), np.array(weight)


def _likelihood(look: Hindsight) -> FloatArray:
    near_m, far_m = look.left_m * (1.0 - _BLUR), look.left_m * (1.0 + _BLUR)
    ends_m = np.array([near_m, far_m] if look.has_ended else [look.left_m, np.inf])
    ends_m = np.minimum(ends_m, look.passage.distance_m[-1])
    passed = np.array([look.passage.bent_within(ends_m, {} if factor == 1.0 else {factor: 1.0}) for factor in FACTORS])
    if not look.has_ended:
        return np.asarray(1.0 - passed[:, 0] + _LEAST)
    return np.asarray(passed[:, 1] - passed[:, 0] + _LEAST)


def _shares(likelihood: FloatArray, weight: FloatArray, before: FloatArray) -> FloatArray:
    """Return the share of each bend; ``before``: how many lives say so already."""
    shares = np.full(len(FACTORS), 1.0 / len(FACTORS))
    for _ in range(_ROUNDS):
        belief = likelihood * shares
        belief *= (weight / belief.sum(axis=1))[:, None]
        shares = belief.sum(axis=0) + before
        shares /= shares.sum()
    return shares
