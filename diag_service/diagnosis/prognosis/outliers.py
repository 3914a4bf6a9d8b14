"""Which clutches age otherwise than their peers, so many at once that chance hardly does it.

Each clutch is held against its kind by a z-score; Benjamini and Hochberg (1995) bound the share of false ones among
those that are named.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from diag_service.diagnosis.prognosis.channels import ChannelName
from diag_service.diagnosis.prognosis.normal import normal_cdf
from diag_service.diagnosis.prognosis.population import Ageing, Course, Population, Usual

FALSE_SHARE: Final = 0.10  # of those that are named


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """How one clutch stands among its peers."""

    ageing: Ageing
    loss_ratio: float  # of its margin, over that of its peers
    z: float  # positive: ages faster
    probability: float  # that a sound clutch ages at least as fast
    is_named: bool  # ages faster than its peers, by more than chance


def standings(lives: Sequence[Ageing], population: Population, *, false_share: float = FALSE_SHARE) -> list[Standing]:
    """Return how the fluids that are in now stand among their peers, the fastest first; those without peers are not."""
    rows = []
    for life in lives:
        peers = population.of(life.kind.vehicle_type, life.kind.fluid)
        usual = None if peers is None else peers.channels.get(ChannelName.MARGIN)
        course = life.courses.get(ChannelName.MARGIN)
        if not life.is_present or usual is None or course is None:
            continue
        rows.append((life, course.loss_per_m / usual.loss_per_m, z_score(course, usual)[0]))
    z = np.array([row[2] for row in rows])
    probability = 1.0 - normal_cdf(z)
    named = discoveries(probability, false_share)
    found = [
        Standing(ageing=life, loss_ratio=ratio, z=score, probability=float(p), is_named=bool(is_named))
        for (life, ratio, score), p, is_named in zip(rows, probability, named, strict=True)
    ]
    return sorted(found, key=lambda one: -one.z)


def z_score(course: Course, usual: Usual) -> tuple[float, float]:
    """Return by how many deviations a loss is more than usual, and how much one is; scatter is that of logarithms."""
    faster = max(course.loss_per_m, 0.0) / usual.loss_per_m
    if faster <= 1.0:
        std = float(np.hypot(course.loss_std_per_m / usual.loss_per_m, usual.loss_log_std))
        return (course.loss_per_m / usual.loss_per_m - 1.0) / std, std
    std = float(np.hypot(usual.loss_log_std, course.loss_std_per_m / course.loss_per_m))
    return float(np.log(faster)) / std, std


def discoveries(probability: FloatArray, false_share: float) -> BoolArray:
    """Return which of many probabilities are too small to be chance, by Benjamini and Hochberg."""
    count = len(probability)
    if not count:
        return np.zeros(0, np.bool_)
    order = np.sort(probability)
    is_below = order <= false_share * np.arange(1, count + 1) / count
    limit = float(order[is_below][-1]) if is_below.any() else -1.0
    return np.asarray(probability <= limit, np.bool_)
