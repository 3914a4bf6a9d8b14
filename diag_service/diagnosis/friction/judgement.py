"""The last events judged together: which of them do not belong, and whether a clutch has changed meanwhile.

One event is held against all others, those after it included, so a bad first shift is found out by the good ones that
follow. Leaving an event out costs as much as explaining it badly; so does a step of a clutch's friction. What costs
least is believed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.evidence import Evidence, Fusion, Knowledge, fuse
from diag_service.diagnosis.friction.parameters import FRICTION_PRIOR_STD, PARAMETER_COUNT, friction_rows
from diag_service.diagnosis.friction.selection import Selection, selected

STEP_COST: Final = 55.0  # more than two events that are left out, less than three
SMALL_STEP_COST: Final = 24.0  # of a change for which none is left out: by chance two numbers more save 24 in 6e-6
STEP_COUNT: Final = 3  # of the newest events of a clutch, which agree that it has changed
STEP_COUNTS: Final = (3, 4)  # of events since a change that is too small for any of them to be left out
_PRIOR: Final = np.eye(2) / FRICTION_PRIOR_STD**2  # information on a step


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedEvent:
    """What one event of a clutch says."""

    clutch: int  # 1 or 2, the one that slipped
    end_ns: int
    evidence: Evidence


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
    judged = _believed(base, events, best)
    known = judged.fusion.knowledge
    for first in _where_changed(events, best.is_used):
        judged = min(judged, _with_change(base, events, first, STEP_COST), key=lambda one: one.cost)
    for first in _where_stepped(events, best, known):
        judged = min(judged, _with_change(base, events, first, SMALL_STEP_COST), key=lambda one: one.cost)
    return judged


def _believed(base: Knowledge, events: Sequence[JudgedEvent], selection: Selection) -> Judgement:
    """Return what a selection of the events and what was known before say together."""
    fusion = fuse(base, together(events, selection.is_used))
    return Judgement(fusion=fusion, is_used=selection.is_used, cost=selection.cost)


def _where_stepped(events: Sequence[JudgedEvent], best: Selection, known: Knowledge) -> Iterator[int]:
    """Yield events of the clutch of the newest one from where on another friction explains what is used much better.

    ``known`` is what the used events say together with what was known before.
    """
    if not events:
        return
    clutch = events[-1].clutch
    rows = [row for row, event in enumerate(events) if event.clutch == clutch and best.is_used[row]]
    for count in STEP_COUNTS:
        if len(rows) >= count:
            first = rows[-count]
            since = together(events[first:], best.is_used[first:])
            if saved_by_step(known, since, clutch) > SMALL_STEP_COST:
                yield first


def saved_by_step(known: Knowledge, since: Evidence, clutch: int) -> float:
    """Return what chi-square would lose if the friction of a clutch had changed right before some of the events.

    The least over that step and all parameters, by Schur's complement of the parameters: chi-square is quadratic.
    """
    rows = friction_rows(clutch)
    by_step = since.matrix[rows]
    gradient = since.vector[rows] - by_step @ known.mean
    (a, b), (c, d) = (by_step[:, rows] - by_step @ known.covariance @ by_step.T + _PRIOR).tolist()
    first, second = gradient.tolist()
    return float((d * first**2 - (b + c) * first * second + a * second**2) / (a * d - b * c))


def _with_change(base: Knowledge, events: Sequence[JudgedEvent], first: int, step_cost: float) -> Judgement:
    """Return what is believed if the clutch of an event changed right before it."""
    older, newer = events[:first], events[first:]
    until = selected(base, [event.evidence for event in older])
    before = fuse(base, together(older, until.is_used)).knowledge
    known = after_change(before, newer[0].clutch)
    since = selected(known, [event.evidence for event in newer])
    return replace(
        _believed(known, newer, since),
        is_used=(*until.is_used, *since.is_used),
        cost=until.cost + since.cost + step_cost,
        first_changed=first,
    )


def together(events: Sequence[JudgedEvent], is_used: Sequence[bool]) -> Evidence:
    """Return what the events say that are used."""
    return Evidence.sum([event.evidence for event, used in zip(events, is_used, strict=False) if used])


def after_change(known: Knowledge, clutch: int) -> Knowledge:
    """Return what is known once the friction of a clutch has changed by nobody knows how much."""
    return known.less_sure(friction_variance(clutch, FRICTION_PRIOR_STD**2))


def friction_variance(clutch: int, variance: float) -> FloatArray:
    """Return a variance for the friction of one clutch, none for all else, shape (PARAMETER_COUNT,)."""
    added = np.zeros(PARAMETER_COUNT)
    added[friction_rows(clutch)] = variance
    return added


def _where_changed(events: Sequence[JudgedEvent], is_used: Sequence[bool]) -> Iterator[int]:
    """Yield events before which their clutch may have changed: its newest are all left out, or all before them are."""
    for clutch in (1, 2):
        rows = [row for row, event in enumerate(events) if event.clutch == clutch]
        used = [is_used[row] for row in rows]
        if not any(used[-STEP_COUNT:]) and len(rows) >= STEP_COUNT:
            yield rows[max((place + 1 for place, is_in in enumerate(used) if is_in), default=0)]
        if not any(used[:STEP_COUNT]) and all(used[-STEP_COUNT:]) and len(rows) >= 2 * STEP_COUNT:
            yield rows[used.index(True)]
