"""Which clutches age otherwise than their peers, so many at once that chance hardly does it; and what all share.

Each clutch is held against its kind by a z-score; Benjamini and Hochberg (1995) bound the share of false ones among
those that are named.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from diag_service.diagnosis.prognosis.channels import ChannelName
from diag_service.diagnosis.prognosis.normal import normal_cdf
from diag_service.diagnosis.prognosis.population import Ageing, Population

FALSE_SHARE: Final = 0.10  # of those that are named
SURE_STEP_STD: Final = 4.0  # of a step that many clutches make at once
LEAST_CLUTCHES: Final = 8  # that say what is common at one time


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
        usual_std = usual.loss_per_m * usual.loss_log_std
        rows.append(
            (
                life,
                course.loss_per_m / usual.loss_per_m,
                _z(course.loss_per_m, course.loss_std_per_m, usual.loss_per_m, usual_std, usual.loss_log_std),
            )
        )
    z = np.array([row[2] for row in rows])
    probability = 1.0 - normal_cdf(z)
    named = discoveries(probability, false_share)
    found = [
        Standing(ageing=life, loss_ratio=ratio, z=score, probability=float(p), is_named=bool(is_named))
        for (life, ratio, score), p, is_named in zip(rows, probability, named, strict=True)
    ]
    return sorted(found, key=lambda one: -one.z)


def _z(loss: float, std: float, usual: float, usual_std: float, log_std: float) -> float:
    """Return by how many deviations a loss is more than usual; scatter of the population is that of logarithms."""
    faster = max(loss, 0.0) / usual
    if faster <= 1.0:
        return (loss - usual) / float(np.hypot(std, usual_std))
    return float(np.log(faster) / np.hypot(log_std, std / loss))


def discoveries(probability: FloatArray, false_share: float) -> BoolArray:
    """Return which of many probabilities are too small to be chance, by Benjamini and Hochberg."""
    count = len(probability)
    if not count:
        return np.zeros(0, np.bool_)
    order = np.sort(probability)
    is_below = order <= false_share * np.arange(1, count + 1) / count
    limit = float(order[is_below][-1]) if is_below.any() else -1.0
    return np.asarray(probability <= limit, np.bool_)


def common_course(period: Int64Array, clutch: Int64Array, value: FloatArray) -> FloatArray:
    """Return what all clutches share at each period: steps that most make at once, added up; shape (periods,).

    A software that reads torque otherwise, or a winter, moves all clutches of a type alike. What a clutch does by
    itself, and the fall that all have in common all the time, stay with it.

    Parameters
    ----------
    period, clutch, value : (n,) array
        Whole numbers from zero, and results of the clutch in the period.
    """
    periods, clutches = int(period.max()) + 1, int(clutch.max()) + 1
    place = clutch * periods + period
    count = np.bincount(place, minlength=periods * clutches).reshape(clutches, periods)
    total = np.bincount(place, value, minlength=periods * clutches).reshape(clutches, periods)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    course = np.zeros(periods)
    steps = np.diff(mean, axis=1)
    usual = _middle(steps[np.isfinite(steps)])[0]
    for column in range(periods - 1):
        own = steps[np.isfinite(steps[:, column]), column]
        if len(own) < LEAST_CLUTCHES:
            continue
        step, std = _middle(own)
        if abs(step - usual) > SURE_STEP_STD * std:
            course[column + 1] = step - usual
    return np.asarray(np.cumsum(course))


def _middle(value: FloatArray) -> tuple[float, float]:
    """Return the median and its deviation."""
    if not len(value):
        return 0.0, 0.0
    middle = float(np.median(value))
    return middle, 1.2533 * 1.4826 * float(np.median(np.abs(value - middle))) / float(np.sqrt(len(value)))
