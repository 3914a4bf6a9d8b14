"""What a vehicle is told to do about its fluid: one order, made here alone, from both clutches and the fluid fills.

Both clutches slip in one oil, so the worse of them decides. An order is about now; what is foretold may only add when.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Final

from fleet_contract.topics import CLUTCHES

NO_VERDICT: Final = "no_verdict"
NEARLY_SURE: Final = 80  # percent; what is less sure is not called sound without more drives
_SURE: Final = re.compile(r"\((?:over )?(\d+) % sure")
UNKNOWN_FLUID: Final = "new fluid, of which no shift is known yet"
_UNSEEN_SINCE: Final = "no event engaged it since the fluid was changed"
# What earlier results say besides the finding: an order for one clutch alone.
_EARLIER: Final = re.compile(
    r"change the fluid now: |have the fluid changed at the next service: |nothing to do [^:]*: |no verdict: |"
    r"drive on and measure again: |have its launches looked at: |; let diag-service calibrate [^.]*"
)
_EARLIER_WORDS: Final = {
    "its fluid is sound": "its friction is sound",
    "its fluid lets it shudder": "it can shudder",
    "50 % of its margin against shudder are gone": "half of its margin against shudder is gone",
}


class Action(StrEnum):
    """What is to be done about the fluid."""

    CHANGE_NOW = "change_now"
    CHANGE_AT_SERVICE = "change_at_service"
    NEW_FLUID = "new_fluid"  # no result of it yet
    MEASURE_AGAIN = "measure_again"  # too little is known
    NOTHING = "nothing"


# As which verdict an order is shown and sorted.
SHOWN_AS: Final = {
    Action.CHANGE_NOW: "change_fluid",
    Action.CHANGE_AT_SERVICE: "watch",
    Action.NEW_FLUID: NO_VERDICT,
    Action.MEASURE_AGAIN: NO_VERDICT,
    Action.NOTHING: "good",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What the last result of a clutch says of it."""

    clutch: int
    condition: str  # the verdict, as messages write it
    text: str | None  # the advice of the verdict; None in results of older programs
    reason: str  # of the verdict
    end_at: datetime  # of the event


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """The order for a vehicle, with what each clutch says; the same wherever people or programs read it."""

    action: Action
    sentence: str
    reasons: tuple[str, ...]  # a sentence for each clutch, clutch 1 first

    @property
    def text(self) -> str:
        """All of it, as one paragraph."""
        return " ".join((self.sentence, *self.reasons))


def is_of_earlier_fluid(end_at: datetime, filled_at: datetime | None) -> bool:
    """Return whether a result says nothing of the fluid that is in: its event ended before that was filled."""
    return filled_at is not None and end_at <= filled_at


def unseen_since_new(clutch: int) -> str:
    """Return what is said of a clutch that no event has engaged since the fluid was changed."""
    return f"Clutch {clutch}: {_UNSEEN_SINCE}."


def order_of(findings: Iterable[Finding], filled_at: datetime | None) -> Order:
    """Return the order for a vehicle from the last result of each clutch, and when the fluid that is in was filled."""
    known = {one.clutch: one for one in findings if not is_of_earlier_fluid(one.end_at, filled_at)}
    conditions = [known[clutch].condition if clutch in known else NO_VERDICT for clutch in CLUTCHES]
    unseen = "no event engaged it yet" if filled_at is None else _UNSEEN_SINCE
    texts = [_ground(known[clutch]) if clutch in known else unseen for clutch in CLUTCHES]
    action, sentence = _decide(conditions, texts)
    if filled_at is not None and not known:
        action = Action.NEW_FLUID
        sentence = f"New fluid since {filled_at:%Y-%m-%d %H:%M} UTC: nothing is known of it yet."
    reasons = tuple(f"Clutch {clutch}: {text}." for clutch, text in zip(CLUTCHES, texts, strict=True))
    return Order(action=action, sentence=sentence, reasons=reasons)


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


def _percent(text: str) -> int:
    """Return how sure a finding is; one that does not say so is as sure as its verdict."""
    found = _SURE.search(text)
    return 100 if found is None else int(found[1])


def _ground(finding: Finding) -> str:
    """Return what a result says of its clutch, without any order and without the full stop."""
    said = finding.text or f"{finding.condition.replace('_', ' ')}: {finding.reason}"
    said = _EARLIER.sub("", said.removeprefix(f"Clutch {finding.clutch}: ")).removesuffix(".")
    for earlier, word in _EARLIER_WORDS.items():
        said = said.replace(earlier, word)
    return said
