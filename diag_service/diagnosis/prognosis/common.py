"""What most clutches of a fleet do at the same time, as a software update makes them, and how it is taken out."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from diag_service.diagnosis.prognosis.history import History

SURE_STEP_STD: Final = 4.0  # of a step that many clutches make at once
LEAST_CLUTCHES: Final = 8  # that say what is common at one time
PERIOD_S: Final = 365.25 / 12.0 * 86_400.0  # a month


@dataclass(frozen=True, slots=True, kw_only=True)
class Common:
    """What all clutches of one type share from a month on, added up: natural logarithms of mu_C and mu_S."""

    first_period: int  # months since the epoch
    mu_c: tuple[float, ...]
    mu_s: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Monthly:
    """The means of one clutch with one fluid, month by month, shape (m,)."""

    period: Int64Array  # months since the epoch
    mu_c: FloatArray  # natural logarithms
    mu_s: FloatArray


def monthly(history: History) -> Iterator[Monthly]:
    """Yield the monthly means of each fluid that is known: a fill is no common step, even where a fleet has many."""
    period = (history.end_s / PERIOD_S).astype(np.int64)
    for number in np.unique(history.fluid_number):
        own = history.fluid_number == number
        periods, place = np.unique(period[own], return_inverse=True)
        count = np.bincount(place)
        means = (np.bincount(place, np.log(mu[own])) / count for mu in (history.mu_c, history.mu_s))
        yield Monthly(period=periods, **dict(zip(("mu_c", "mu_s"), means, strict=True)))


def common_of(clutches: Iterable[Monthly]) -> Common | None:
    """Return what the clutches of one type share; None: nothing."""
    known = list(clutches)
    if not known:
        return None
    first = min(int(one.period[0]) for one in known)
    period = np.concatenate([one.period for one in known]) - first
    clutch = np.repeat(np.arange(len(known)), [len(one.period) for one in known])
    courses = [
        common_course(period, clutch, np.concatenate([getattr(one, name) for one in known]))
        for name in ("mu_c", "mu_s")
    ]
    if not any(np.any(one) for one in courses):
        return None
    mu_c, mu_s = (tuple(one.tolist()) for one in courses)
    return Common(first_period=first, mu_c=mu_c, mu_s=mu_s)


def without(history: History, common: Common | None) -> History:
    """Return a history without what all clutches of its type share; after the last month that is known it stays."""
    if common is None:
        return history
    last = len(common.mu_c) - 1
    place = (history.end_s / PERIOD_S).astype(np.int64) - common.first_period
    return replace(
        history,
        mu_c=_without(history.mu_c, common.mu_c, np.clip(place, 0, last)),
        mu_s=_without(history.mu_s, common.mu_s, np.clip(place, 0, last)),
    )


def _without(mu: FloatArray, course: Sequence[float], place: Int64Array) -> FloatArray:
    return np.asarray(mu * np.exp(-np.array(course)[place]))


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
