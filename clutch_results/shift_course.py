"""What the quality of many gear changes comes to: by kind, gears and oil; what the clutches bore."""

import re
from bisect import bisect
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from statistics import fmean
from typing import Final

from clutch_model.units import degc_from_k
from clutch_results.event_kinds import EventKind, ShiftQuality, events_text
from clutch_results.loads import PARTS, Load, borne
from clutch_results.records import ShiftEstimate

COURSE_COUNT: Final = 20  # changes of a kind at either end of a course
COLD_DEGC, HOT_DEGC = 40.0, 90.0  # of the oil
POOR: Final = 70.0  # a score that is worth a look
MOST_POOR: Final = 3
LEAST_FIRST: Final = 5  # scores of a kind, against which later ones are held
_UNIT: Final = re.compile(r"_(s|pa|nm|k|rad_s2?|m_s[23])$")


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftCourse:
    """How changes of one kind between two gears went."""

    kind: EventKind
    from_gear: int
    to_gear: int
    count: int
    first: float  # mean score of the first of them
    last: float  # of the last
    by_oil: tuple[float | None, float | None, float | None]  # cold, warm, hot
    reason: str  # the part that cost most most often, of the last; empty: none
    untold: tuple[str, ...] = ()  # parts that no change of them has, for want of signals


def courses(estimates: Iterable[ShiftEstimate]) -> list[ShiftCourse]:
    """Return how the changes went, by kind and gears; estimates in their order."""
    groups: dict[tuple[EventKind, int, int], list[tuple[float, float | None, ShiftQuality]]] = {}
    for estimate in estimates:
        quality = estimate.shift_quality
        if quality is not None and quality.score is not None:
            change = quality.score, estimate.conditions.sump_temperature_k, quality
            groups.setdefault((estimate.kind, estimate.from_gear, estimate.to_gear), []).append(change)
    known = []
    for (kind, from_gear, to_gear), group in sorted(groups.items()):
        by_oil: list[list[float]] = [[], [], []]
        for score, oil_k, _ in group:
            if oil_k is not None:
                by_oil[bisect((COLD_DEGC, HOT_DEGC), degc_from_k(oil_k))].append(score)
        reasons = Counter(quality.reasons[0] for *_, quality in group[-COURSE_COUNT:] if quality.reasons)
        known.append(
            ShiftCourse(
                kind=kind,
                from_gear=from_gear,
                to_gear=to_gear,
                count=len(group),
                first=fmean(score for score, *_ in group[:COURSE_COUNT]),
                last=fmean(score for score, *_ in group[-COURSE_COUNT:]),
                by_oil=tuple(fmean(scores) if scores else None for scores in by_oil),  # type: ignore[arg-type]
                reason=reasons.most_common(1)[0][0] if reasons else "",
                untold=tuple(
                    part.name
                    for part in PARTS
                    if all(getattr(quality.parts, part.name) is None for *_, quality in group)
                ),
            )
        )
    return known


COURSE_HEAD: Final = (
    *("change", "count", f"first {COURSE_COUNT}", f"last {COURSE_COUNT}"),
    *("cold oil", "warm", "hot", "mostly costs"),
)


def course_row(one: ShiftCourse) -> tuple[str, ...]:
    """Return how changes of one kind went, as texts under their heads: scores, 100 is faultless."""
    scores = ("–" if score is None else f"{score:.0f}" for score in (one.first, one.last, *one.by_oil))
    return change_words(one), str(one.count), *scores, part_words(one.reason)


def part_words(name: str) -> str:
    """Return the name of a part of a score for people: without its unit."""
    return _UNIT.sub("", name).replace("_", " ")


def change_words(one: ShiftCourse) -> str:
    """Return the kind and the gears of a change for people."""
    return f"{one.kind.value.replace('_', ' ')} {one.from_gear}-{one.to_gear}"


def course_lines(known: Sequence[ShiftCourse]) -> list[str]:
    """Return which changes go worst now, and why, and what the signals do not tell."""
    worst = sorted((course for course in known if course.last < POOR), key=lambda course: course.last)[:MOST_POOR]
    lines = [f"{change_words(one).capitalize()} scores {one.last:.0f}: {part_words(one.reason)}." for one in worst]
    untold = [part_words(part.name) for part in PARTS if known and all(part.name in course.untold for course in known)]
    if untold:
        lines.append(f"Scores are without what the signals do not tell: {', '.join(untold)}.")
    return lines


def fall_of(estimates: Iterable[ShiftEstimate]) -> float | None:
    """Return by how many points the last changes are worse than the first of their kind and gears; None: too few."""
    first: dict[tuple[EventKind, int, int], list[float]] = {}
    falls = []
    for estimate in estimates:
        if estimate.shift_quality is not None and (score := estimate.shift_quality.score) is not None:
            scores = first.setdefault((estimate.kind, estimate.from_gear, estimate.to_gear), [])
            if len(scores) >= LEAST_FIRST:
                falls.append(fmean(scores) - score)
            if len(scores) < COURSE_COUNT:
                scores.append(score)
    return fmean(falls[-COURSE_COUNT:]) if len(falls) >= COURSE_COUNT else None


def loads(estimates: Iterable[ShiftEstimate]) -> list[Load]:
    """Return what each clutch had to bear, those that did."""
    return [load for _, load in sorted(reduce(borne, estimates, dict[int, Load]()).items())]


def load_line(load: Load) -> str:
    """Return what a clutch had to bear as one line for people."""
    if not any(load.counts):
        return f"Launches of clutch {load.clutch}: {load.launch_count}; the signals do not tell what heat it took."
    hottest = "" if load.peak_k is None else f", at most {degc_from_k(load.peak_k):.0f} °C"
    return (
        f"Clutch {load.clutch} turned {load.energy_j / 1e6:.2f} MJ into heat in {events_text(sum(load.counts))}, "
        f"launches: {load.launch_count}{hottest}; {100.0 * load.life_ratio:.4f} % of its lining's life, as an index."
    )
