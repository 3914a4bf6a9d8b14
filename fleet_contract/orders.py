"""What a vehicle is told to do: one order, made here alone, from both clutches, likely causes and the fluid fills.

Both clutches slip in one oil, so the worse of them decides, unless something that new fluid alone does not mend is
likely enough: that comes first. An order is about now; what is foretold may only add when.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Final, NamedTuple, TypeVar

from fleet_contract.topics import CLUTCHES

EARLIEST: Final = datetime(1970, 1, 1, tzinfo=UTC)  # of a fill: an earlier one is a slip of the pen
_DATED: Final = EARLIEST + timedelta(seconds=1e9)  # an earlier moment is of a clock that was not set
SAME_WITHIN: Final = timedelta(days=1)  # nobody changes the fluid twice a day, but two people may note it
FARTHEST_M: Final = 2.0e7  # that a vehicle drives unheard of between its last result and a fill
READING_M: Final = 1.0e4  # by which two readings of one moment may differ
HIGHEST_M: Final = 5.0e9  # no car has driven farther
INSIST: Final = "--insist notes it all the same, as after a change of the instrument cluster"
FillT = TypeVar("FillT")


def distinct(fills: Iterable[FillT], moment: Callable[[FillT], datetime]) -> list[FillT]:
    """Return fills, the earliest first, without those that were noted within a day of the one before them."""
    distinct_fills: list[FillT] = []
    for fill in sorted(fills, key=moment):
        if not distinct_fills or moment(fill) - moment(distinct_fills[-1]) >= SAME_WITHIN:
            distinct_fills.append(fill)
    return distinct_fills


def fill_meant(fills: Iterable[FillT], moment: Callable[[FillT], datetime], at: datetime | None) -> FillT | None:
    """Return the fill nearest to a moment, within a day of it; without a moment the last fill."""
    known = distinct(fills, moment)
    if at is None:
        return known[-1] if known else None
    near = (fill for fill in known if abs(moment(fill) - at) < SAME_WITHIN)
    return min(near, key=lambda fill: abs(moment(fill) - at), default=None)


def odometer_complaint(odometer_m: float | None, before_m: float | None, after_m: float | None) -> str:
    """Return why a fill cannot have this odometer, by the readings before and after it; empty if it can."""
    if odometer_m is None:
        return ""
    begin = f"the odometer cannot read {_km(odometer_m)}"
    if odometer_m > HIGHEST_M:
        return f"{begin}: no car has driven that far"
    if after_m is not None and odometer_m > after_m + READING_M:
        return f"{begin}: after that it read {_km(after_m)}; {INSIST}"
    if before_m is not None and not -READING_M <= odometer_m - before_m <= FARTHEST_M:
        return f"{begin}: it read {_km(before_m)} before; {INSIST}"
    return ""


def _km(distance_m: float) -> str:
    return f"{distance_m / 1000.0:,.0f} km"


NO_VERDICT: Final = "no_verdict"
NEARLY_SURE: Final = 80  # percent; what is less sure is not called sound without more drives
_SURE: Final = re.compile(r"\((?:over )?(\d+) % sure")
UNKNOWN_FLUID: Final = "new fluid, of which no shift is known yet"
_UNSEEN_SINCE: Final = "nothing is known of it with this fluid"
UNTOLD: Final = "the signals of this vehicle do not tell its friction"
"""What is said of each clutch of a vehicle whose signals do not suffice, by programs of all versions."""
LEVEL_UNTOLD: Final = (
    "the torque of the engine is not measured: friction is known up to a scale at best and cannot be called sound"
)
UNKNOWABLE: Final = {
    UNTOLD: "There is no verdict on the fluid: friction cannot be known from this car.",
    LEVEL_UNTOLD: (
        "There is no verdict on the fluid: the torque of the engine is not measured, and without it friction is known "
        "up to a scale at best."
    ),
}
"""The order for a vehicle of which nothing else is said: it is no matter of a clutch, nor of more events."""
SLOPE_ALONE: Final = "There is no verdict on the fluid: of this car's friction only the slope over slip can be known."
# What earlier results say besides the finding: an order for one clutch alone.
_EARLIER: Final = re.compile(
    r"change the fluid now: |have the fluid changed at the next service: |nothing to do [^:]*: |no verdict: |"
    r"drive on and measure again: |have its launches looked at: |; let diag-service calibrate [^.]*"
)
_EARLIER_WORDS: Final = {
    "its fluid is sound": "its friction is sound",
    "its fluid lets it shudder": "it can shudder",
    "50 % of its margin against shudder are gone": "more than half of its margin against shudder is gone",
}


class Action(StrEnum):
    CHANGE_NOW = "change_now"
    CHANGE_AT_SERVICE = "change_at_service"
    FIND_CAUSE = "find_cause"  # new fluid alone would not mend what is likely
    NEW_FLUID = "new_fluid"  # no result of it yet
    MEASURE_AGAIN = "measure_again"  # too little is known
    NOTHING = "nothing"


# As which verdict an order is shown and sorted.
SHOWN_AS: Final = {
    Action.CHANGE_NOW: "change_fluid",
    Action.CHANGE_AT_SERVICE: "watch",
    Action.FIND_CAUSE: "watch",
    Action.NEW_FLUID: NO_VERDICT,
    Action.MEASURE_AGAIN: NO_VERDICT,
    Action.NOTHING: "good",
}


class Suspect(NamedTuple):
    """Something that may be wrong with a vehicle."""

    cause: str  # a word such as glazed-lining
    clutch: int | None
    probability: float

    def __str__(self) -> str:
        return cause_words(self.cause, self.clutch)


_SOUND: Final = "sound"
_RENEWED: Final = "renewed-fluid"
_MENDED_BY_FLUID: Final = frozenset({_SOUND, "aged-fluid", _RENEWED})
_OF_THE_FLUID: Final = {"water": "water in the fluid", "wrong-fluid": "another fluid than specified"}
NOT_NOTED: Final = (
    "Was the fluid changed? Friction is as after a fill that nobody noted; diag-service fluid-changed notes it."
)
_BLAMED: Final = frozenset({"change_fluid", "watch"})
LIKELIER: Final = 0.5  # so likely what new fluid alone does not mend holds back an order to change it
NEARLY_CERTAIN: Final = 0.9  # and gives one where nothing is said against the fluid


def cause_words(cause: str, clutch: int | None) -> str:
    if cause == _SOUND:
        return "no cause found"
    return cause.replace("-", " ") + ("" if clutch is None else f" of clutch {clutch}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchFinding:
    """What the last result of a clutch says of it."""

    clutch: int
    element: str | None = None  # its name, where it is neither clutch 1 nor clutch 2 of a pair
    condition: str  # the verdict, as messages write it
    text: str | None  # the advice of the verdict; None in results of older programs
    reason: str  # of the verdict
    end_at: datetime  # of the event
    since_at: datetime | None = None  # what was known goes back to an event of then; None: to none of another drive
    suspects: tuple[Suspect, ...] = ()  # of the vehicle, the likeliest first
    is_renewed: bool = False  # friction has risen since the baseline, by more than it does with one fluid


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """The order for a vehicle, with what each clutch says; the same wherever people or programs read it."""

    action: Action
    sentence: str
    reasons: tuple[str, ...]  # a sentence for each clutch, clutch 1 first
    notes: tuple[str, ...] = ()  # what else is to be known, such as that dates contradict the odometer

    @property
    def text(self) -> str:
        return " ".join((self.sentence, *self.reasons, *self.notes))


def is_of_earlier_fluid(end_at: datetime, filled_at: datetime | None, since_at: datetime | None = None) -> bool:
    """Return whether a result is of earlier fluid: its event, or the first one it rests on, was before the fill.

    A result without a date is held against a fill without one alone: nobody can tell which of both came first.
    """
    at = since_at or end_at
    return filled_at is not None and at <= filled_at and (at >= _DATED or filled_at < _DATED)


def name_of(clutch: int, element: str | None) -> str:
    """Return the name of a clutch: its own, or its number."""
    return element or f"clutch {clutch}"


def title_of(clutch: int, element: str | None) -> str:
    """Return the name of a clutch at the beginning of a sentence: its own, or its number."""
    name = name_of(clutch, element)
    return name[0].upper() + name[1:]


def unseen_since_new(clutch: int, element: str | None = None) -> str:
    """Return what is said of a clutch of which no verdict is of the fluid that is in."""
    return f"{title_of(clutch, element)}: {_UNSEEN_SINCE}."


def order_of(findings: Iterable[ClutchFinding], filled_at: datetime | None, elements: Iterable[str] = ()) -> Order:
    """Return the order by the last result of each clutch, when the fluid was filled, and names that are no numbers."""
    findings = list(findings)
    known = {
        finding.clutch: finding
        for finding in findings
        if not is_of_earlier_fluid(finding.end_at, filled_at, finding.since_at)
    }
    names = dict(enumerate(elements, 1)) | {finding.clutch: finding.element for finding in findings if finding.element}
    clutches = tuple(names) or CLUTCHES  # elements with names are all that there are
    conditions = [known[clutch].condition if clutch in known else NO_VERDICT for clutch in clutches]
    unseen = "no event engaged it yet" if filled_at is None else _UNSEEN_SINCE
    texts = [_ground(known[clutch]) if clutch in known else unseen for clutch in clutches]
    action, sentence = _decide(conditions, texts)
    newest = max(known.values(), key=lambda finding: finding.end_at, default=None)
    if newest is not None and (suspect := _beside_fluid(newest.suspects, conditions)) is not None:
        action = Action.FIND_CAUSE
        what = "See to another cause than the fluid first"
        if suspect.cause in _OF_THE_FLUID:
            what = "See to this first"
        elif _BLAMED.isdisjoint(conditions):
            what = "Have something else than the fluid looked at"
        named = _OF_THE_FLUID.get(suspect.cause, str(suspect))
        sentence = f"{what}: {named} ({_likely(suspect.probability)} likely)."
    if filled_at is not None and not known:
        action = Action.NEW_FLUID
        sentence = f"New fluid since {filled_at:%Y-%m-%d %H:%M} UTC: nothing is known of it yet."
    is_unnoted = filled_at is None and newest is not None and _is_renewed(newest, known.values())
    titles = (title_of(clutch, names.get(clutch)) for clutch in clutches)
    reasons = tuple(f"{title}: {text}." for title, text in zip(titles, texts, strict=True))
    grounds = {_ground(finding) for finding in known.values()}
    if action is Action.MEASURE_AGAIN and len(grounds) == 1 and grounds <= UNKNOWABLE.keys():
        # Said once, also for a clutch that no event engaged.
        sentence, reasons = UNKNOWABLE[grounds.pop()], ()
    return Order(action=action, sentence=sentence, reasons=reasons, notes=(NOT_NOTED,) if is_unnoted else ())


def _decide(conditions: list[str], texts: list[str]) -> tuple[Action, str]:
    if "change_fluid" in conditions:
        return Action.CHANGE_NOW, "Change the fluid now."
    if "watch" in conditions:
        return Action.CHANGE_AT_SERVICE, "Have the fluid changed at the next service."
    if NO_VERDICT in conditions:
        return Action.MEASURE_AGAIN, "There is no verdict on the fluid yet."
    if min(map(_percent, texts)) < NEARLY_SURE:
        return Action.NOTHING, "Nothing to do now, but measure again after more drives: the fluid seems sound."
    return Action.NOTHING, "Nothing to do now: the fluid is sound."


def _beside_fluid(suspects: Iterable[Suspect], conditions: list[str]) -> Suspect | None:
    """Return the likeliest cause that new fluid alone does not mend, if it is likely enough to be seen to first."""
    others = (suspect for suspect in suspects if suspect.cause not in _MENDED_BY_FLUID)
    first = max(others, key=lambda suspect: suspect.probability, default=None)
    least = NEARLY_CERTAIN if _BLAMED.isdisjoint(conditions) else LIKELIER
    return None if first is None or first.probability < least else first


def _is_renewed(newest: ClutchFinding, findings: Iterable[ClutchFinding]) -> bool:
    """Return whether friction is as after a fill: the likely causes say so, or it has risen where they say nothing."""
    if newest.suspects:
        return any(suspect.cause == _RENEWED and suspect.probability >= LIKELIER for suspect in newest.suspects)
    return any(finding.is_renewed for finding in findings)


def _likely(probability: float) -> str:
    return "over 99 %" if probability > 0.995 else f"{100.0 * probability:.0f} %"


def _percent(text: str) -> int:
    """Return how sure a finding is; one that does not say so is as sure as its verdict."""
    match = _SURE.search(text)
    return 100 if match is None else int(match[1])


def _ground(finding: ClutchFinding) -> str:
    """Return the finding on a clutch, without the order that earlier programs added, and without the full stop."""
    text = finding.text or f"{finding.condition.replace('_', ' ')}: {finding.reason}"
    text = _EARLIER.sub("", text.removeprefix(f"{title_of(finding.clutch, finding.element)}: ")).removesuffix(".")
    for earlier, word in _EARLIER_WORDS.items():
        text = text.replace(earlier, word)
    return text
