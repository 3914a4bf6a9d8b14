"""The last events judged together: which of them do not belong, and whether a clutch has changed meanwhile.

One event is held against all others, those after it included, so a bad first shift is found out by the good ones that
follow. Leaving an event out costs as much as explaining it badly; so does a step of a clutch's friction. What costs
least is believed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from diag_service.diagnosis.friction.evidence import (
    FRICTION_PRIOR_STD,
    FRICTION_ROWS,
    PARAMETER_COUNT,
    Evidence,
    Fusion,
    Knowledge,
    fuse,
)

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


class _Search(NamedTuple):
    """Events and what was known before them, in standard deviations of that."""

    precision: FloatArray  # (p, p) of what was known
    matrices: FloatArray  # (events, p, p) of information, without what was certain
    gradients: FloatArray  # (events, p)
    constants: FloatArray  # (events,) chi-square of what was known
    omissions: FloatArray  # (events,) what it costs to leave one out


def _search(base: Knowledge, evidences: Sequence[Evidence]) -> _Search:
    count, number, std = len(base.mean), len(evidences), base.std()
    scale = np.outer(std, std)
    covariance = np.divide(base.covariance, scale, out=np.zeros_like(scale), where=scale > 0.0)
    np.fill_diagonal(covariance, 1.0 + _JITTER)  # also of what was certain
    matrices = np.array([one.matrix for one in evidences]).reshape(number, count, count)
    vectors = np.array([one.vector for one in evidences]).reshape(number, count)
    return _Search(
        precision=np.linalg.inv(covariance),
        matrices=matrices * scale,
        gradients=(vectors - matrices @ base.mean) * std,
        constants=np.array([one.constant for one in evidences]) + (matrices @ base.mean - 2.0 * vectors) @ base.mean,
        omissions=np.array([omission_cost(one) for one in evidences], dtype=np.float64),
    )


def _settled(search: _Search, is_used: BoolArray) -> Selection:
    """Return the selection in which no single event taken in or left out saves anything.

    Takes in or leaves out what saves most, one event at a time, until nothing does.
    """
    cost = np.inf
    while True:
        information = search.precision + search.matrices[is_used].sum(axis=0)
        gradient = search.gradients[is_used].sum(axis=0)
        spent = float(search.constants[is_used].sum() + search.omissions[~is_used].sum())
        if np.isinf(cost):
            cost = spent - float(_saved(information, gradient))
        sign = np.where(is_used, -1.0, 1.0)
        saved = _saved(information + sign[:, None, None] * search.matrices, gradient + sign[:, None] * search.gradients)
        tried = np.nan_to_num(spent + sign * (search.constants - search.omissions) - saved, nan=np.inf)
        best = int(tried.argmin()) if len(tried) else None
        if best is None or not tried[best] < cost - _LEAST_SAVING:
            return Selection(is_used=tuple(is_used.tolist()), cost=cost)
        is_used[best], cost = not is_used[best], float(tried[best])


def _saved(information: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return ``gradient @ inv(information) @ gradient``: (..., p, p) and (..., p) to (...)."""
    step = np.linalg.solve(information, gradient[..., None])[..., 0]
    return np.asarray((gradient * step).sum(axis=-1))


STEP_COST: Final = 55.0  # more than two events that are left out, less than three
SMALL_STEP_COST: Final = 24.0  # of a change for which none is left out: by chance two numbers more save 24 in 6e-6
LEAST_SCATTER: Final = 0.18  # of the variance that events are granted: they count as differing by no less
SCATTER_COUNT: Final = 8  # of events that show by how much they differ
PLAIN_STEP_RATIO: Final = 0.04  # of mu_C: a smaller change, against the scatter of a few events, is none
STEP_COUNT: Final = 3  # of the newest events of a clutch, which agree that it has changed
STEP_COUNTS: Final = (3, 4, 5, 6)  # of events since a change that is too small for any of them to be left out
_PRIOR: Final = np.eye(2) / FRICTION_PRIOR_STD**2  # information on a step


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedEvent:
    """What one event of a clutch says."""

    clutch: int  # 1 or 2, the one that slipped
    end_ns: int
    evidence: Evidence
    is_off_like_others: bool = False  # by errors that all such events share, so that they agree better than they are


MOST_APART: Final = 9.0  # of two numbers 1 % are more by chance: what is beyond is left out, or a change
LEAST_BY_CHANCE: Final = 1.5  # of two numbers: the first event of a clutch agrees with nothing but what was assumed
STATED_COUNT: Final = 5.0  # numbers that are as far apart as was stated, before any event: those of three
SCATTER_KEPT: Final = 0.99  # of what an event says of it after each later one: some hundred count


class Scatter(NamedTuple):
    """By how much the friction of single events is apart; docs/model.md, equation (38)."""

    apart: float = 0.0  # chi-square that events would save, older ones faded, had each a friction of its own
    by_chance: float = 0.0  # likewise, were deviations as stated

    @property
    def ratio(self) -> float:
        """Of the variance that events are granted."""
        return (STATED_COUNT + self.apart) / (STATED_COUNT + self.by_chance)

    def with_event(self, known: Knowledge, event: JudgedEvent) -> "Scatter":
        """Return it after an event which is part of what is known."""
        apart, _, by_chance = step_since(known, event.evidence, event.clutch)
        if by_chance < LEAST_BY_CHANCE:
            return self
        if event.is_off_like_others:
            apart = max(apart, by_chance)
        return Scatter(SCATTER_KEPT * self.apart + min(apart, MOST_APART), SCATTER_KEPT * self.by_chance + by_chance)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What is believed of some events."""

    fusion: Fusion
    is_used: tuple[bool, ...]
    cost: float  # chi-square, and what leaving out costs
    first_changed: int | None = None  # from that event on its clutch has another friction


def judge(base: Knowledge, events: Sequence[JudgedEvent]) -> Judgement:
    """Return what is believed of events, the oldest first, given what was known before them."""
    best = selected(base, [event.evidence for event in events])
    fusion = fuse(base, together(events, best.is_used))
    judged = Judgement(fusion=fusion, is_used=best.is_used, cost=best.cost)
    for first, cost in (*_where_changed(events, best.is_used), *_where_stepped(events, best, fusion.knowledge)):
        judged = min(judged, _with_change(base, events, first, cost), key=lambda one: one.cost)
    return judged


def _where_stepped(events: Sequence[JudgedEvent], best: Selection, known: Knowledge) -> Iterator[tuple[int, float]]:
    """Yield from where on the newest one's clutch may have another friction than is ``known``, and what that costs."""
    rows = [row for row, event in enumerate(events) if event.clutch == events[-1].clutch and best.is_used[row]]
    for count in STEP_COUNTS:
        if len(rows) >= count:
            first, cost = rows[-count], SMALL_STEP_COST
            saved, ratio, _ = step_since(known, together(events[first:], best.is_used[first:]), events[-1].clutch)
            if LEAST_SCATTER * cost < saved < cost and abs(ratio) > PLAIN_STEP_RATIO:
                cost *= _scatter(events, best, known, saved)
            if saved > cost:
                yield first, cost


def _scatter(events: Sequence[JudgedEvent], best: Selection, known: Knowledge, saved: float) -> float:
    """Return by which part of the variance that they are granted the used events differ, but for a step."""
    used = [event for event, is_used in zip(events, best.is_used, strict=True) if is_used]
    if len(used) < SCATTER_COUNT:
        return 1.0
    apart = sum(step_since(known, event.evidence, event.clutch)[0] for event in used)
    return min(max((apart - saved) / (2 * len(used) - 2), LEAST_SCATTER), 1.0)


def step_since(known: Knowledge, since: Evidence, clutch: int) -> tuple[float, float, float]:
    """Return what chi-square would lose if the friction of a clutch had changed right before some of the events.

    The least over that step and all parameters, by Schur's complement of the parameters: chi-square is quadratic. The
    second number is the part of mu_C by which it would have changed, the third what is lost by chance: at most 2.
    """
    rows = FRICTION_ROWS[clutch - 1]
    by_step = since.matrix[rows]
    gradient = since.vector[rows] - by_step @ known.mean
    (a, b), (c, d) = (by_step[:, rows] - by_step @ known.covariance @ by_step.T + _PRIOR).tolist()
    first, second = gradient.tolist()
    determinant = a * d - b * c
    saved = (d * first**2 - (b + c) * first * second + a * second**2) / determinant
    by_chance = 2.0 - (a + d) / determinant / FRICTION_PRIOR_STD**2
    return saved, (d * first - b * second) / determinant / float(known.mean[rows.start]), by_chance


def _with_change(base: Knowledge, events: Sequence[JudgedEvent], first: int, step_cost: float) -> Judgement:
    """Return what is believed if the clutch of an event changed right before it."""
    older, newer = events[:first], events[first:]
    until = selected(base, [event.evidence for event in older])
    before = fuse(base, together(older, until.is_used)).knowledge
    known = after_change(before, newer[0].clutch)
    since = selected(known, [event.evidence for event in newer])
    return Judgement(
        fusion=fuse(known, together(newer, since.is_used)),
        is_used=(*until.is_used, *since.is_used),
        cost=until.cost + since.cost + step_cost,
        first_changed=first,
    )


def together(events: Sequence[JudgedEvent], is_used: Sequence[bool]) -> Evidence:
    return Evidence.sum([event.evidence for event, used in zip(events, is_used, strict=False) if used])


def after_change(known: Knowledge, clutch: int) -> Knowledge:
    """Return what is known once the friction of a clutch has changed by nobody knows how much."""
    added = np.zeros(PARAMETER_COUNT)
    added[FRICTION_ROWS[clutch - 1]] = FRICTION_PRIOR_STD**2
    return known.less_sure(added)


def _where_changed(events: Sequence[JudgedEvent], is_used: Sequence[bool]) -> Iterator[tuple[int, float]]:
    """Yield events before which their clutch may have changed: its newest are all left out, or all before them are."""
    for clutch in (1, 2):
        rows = [row for row, event in enumerate(events) if event.clutch == clutch]
        used = [is_used[row] for row in rows]
        if not any(used[-STEP_COUNT:]) and len(rows) >= STEP_COUNT:
            yield rows[max((place + 1 for place, is_in in enumerate(used) if is_in), default=0)], STEP_COST
        if not any(used[:STEP_COUNT]) and all(used[-STEP_COUNT:]) and len(rows) >= 2 * STEP_COUNT:
            yield rows[used.index(True)], STEP_COST
