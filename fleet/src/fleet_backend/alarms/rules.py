"""Rules that raise and clear alarms: pure, and with hysteresis, so that a value at a limit raises one alarm."""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from enum import StrEnum
from itertools import pairwise

from clutchdiag_io.people import is_dated
from fleet_backend.ageing.records import ClutchNow, Severity
from fleet_backend.schema import CLOCK_ERROR
from fleet_contract.orders import Action, name_of

WHOLE_VEHICLE = 0  # in place of the number of a clutch


class AlarmRule(StrEnum):
    """What an alarm is about."""

    VERDICT = "verdict"  # the fluid of a clutch is to be changed
    DUE = "due"  # it probably has to be before the next service
    QUALITY = "quality"  # most events of a clutch cannot be used
    ODOMETER = "odometer"  # it went back or leapt
    SILENCE = "silence"  # nothing was heard of a vehicle
    CAUSE = "cause"  # something is probably wrong that new fluid does not mend
    SCORE = "score"  # gears are changed worse than before
    CORRECTION = "correction"  # of releases before 0.10: no longer raised
    QUOTA = "quota"  # it sends more than is taken of it in a day


class AlarmEvent(StrEnum):
    """What happened to an alarm."""

    RAISED = "raised"
    CLEARED = "cleared"


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Where alarms begin and where they end."""

    due_from: float = 0.5  # probability that the change is due before the next service
    due_until: float = 0.3
    unused_from: float = 0.5  # share of the last events that could not be used
    unused_until: float = 0.25
    unused_events: int = 50
    least_events: int = 20
    fall_from: float = 15.0  # points of the score, means of the last twenty against the first of each kind
    fall_until: float = 8.0
    leap_m: float = 1.0e8  # between two results, which no vehicle drives
    silence_from: timedelta = timedelta(days=14)
    silence_until: timedelta = timedelta(days=1)


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Subject:
    """What an alarm is of; at most one of each is open at a time."""

    vehicle: str
    clutch: int = WHOLE_VEHICLE
    rule: AlarmRule
    element: str | None = field(default=None, compare=False)  # name of the clutch, as of `ClutchNow`

    def __str__(self) -> str:
        return self.vehicle + (f", {name_of(self.clutch, self.element)}" if self.clutch else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleFinding:
    """What a rule says now; ``is_wrong`` is None between where alarms begin and where they end: it stays as it was."""

    subject: Subject
    is_wrong: bool | None
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """An alarm that is raised or cleared."""

    subject: Subject
    event: AlarmEvent
    reason: str
    at: datetime


def verdict_finding(clutch: ClutchNow, *, is_old_fluid: bool) -> RuleFinding:
    """Return what the verdict says; one that is none changes nothing, unless all that spoke was an earlier fluid."""
    is_unknown = clutch.condition == Severity.NO_VERDICT and not is_old_fluid
    is_wrong = None if is_unknown else clutch.condition == Severity.CHANGE_FLUID
    return RuleFinding(subject=_subject(clutch, AlarmRule.VERDICT), is_wrong=is_wrong, reason=clutch.order)


def cause_finding(clutch: ClutchNow) -> RuleFinding:
    """Return whether the order of a vehicle names another cause than its fluid; of an order without a verdict None."""
    is_unknown = clutch.action in {Action.MEASURE_AGAIN, Action.NEW_FLUID}
    is_wrong = None if is_unknown else clutch.action == Action.FIND_CAUSE
    subject = Subject(vehicle=clutch.vehicle, rule=AlarmRule.CAUSE)
    return RuleFinding(subject=subject, is_wrong=is_wrong, reason=clutch.order)


def due_finding(clutch: ClutchNow, probability: float | None, sentence: str, limits: Limits) -> RuleFinding:
    """Return what the prognosis says; None: there is no trend, which is not wrong."""
    is_wrong = False if probability is None else _beyond(probability, limits.due_from, limits.due_until)
    return RuleFinding(subject=_subject(clutch, AlarmRule.DUE), is_wrong=is_wrong, reason=sentence)


def quality_finding(clutch: ClutchNow, unused_count: int, event_count: int, limits: Limits) -> RuleFinding:
    """Return what the last events say of the data; a few say nothing."""
    share = unused_count / max(event_count, 1)
    is_wrong = None if event_count < limits.least_events else _beyond(share, limits.unused_from, limits.unused_until)
    name = name_of(clutch.clutch, clutch.element)
    reason = f"{unused_count} of the last {event_count} events of {name} could not be used"
    return RuleFinding(subject=_subject(clutch, AlarmRule.QUALITY), is_wrong=is_wrong, reason=reason)


def score_finding(clutch: ClutchNow, fall: float | None, limits: Limits) -> RuleFinding:
    """Return whether gears are changed worse than before; None: too few changes tell."""
    is_wrong = None if fall is None else _beyond(fall, limits.fall_from, limits.fall_until)
    points = f"{fall or 0.0:.0f} points less than the first of their kind"
    reason = f"the last changes to gears of {name_of(clutch.clutch, clutch.element)} score {points}"
    return RuleFinding(subject=_subject(clutch, AlarmRule.SCORE), is_wrong=is_wrong, reason=reason)


def odometer_finding(clutch: ClutchNow, readings_m: Sequence[float], limits: Limits) -> RuleFinding:
    """Return whether the last readings of an odometer, in their order, can be those of one."""
    wrong = [(a, b) for a, b in pairwise(readings_m) if not 0.0 <= b - a <= limits.leap_m]
    reason = "the odometer is plausible"
    if wrong:
        before_m, after_m = wrong[-1]
        reason = f"the odometer went from {before_m / 1000.0:,.0f} km to {after_m / 1000.0:,.0f} km between two results"
    return RuleFinding(subject=_subject(clutch, AlarmRule.ODOMETER), is_wrong=bool(wrong), reason=reason)


def heard_last(moments: Iterable[datetime | None], now: datetime) -> datetime | None:
    """Return the last moment at which a vehicle was heard; without those that have no date or are yet to come."""
    known = (at for at in moments if at is not None)
    return max((at for at in known if is_dated(at) and at <= now + CLOCK_ERROR), default=None)


def silence_finding(vehicle: str, last_heard_at: datetime, now: datetime, limits: Limits) -> RuleFinding:
    """Return whether too long nothing was heard of a vehicle."""
    is_wrong = _beyond(
        (now - last_heard_at).total_seconds(), limits.silence_from.total_seconds(), limits.silence_until.total_seconds()
    )
    reason = f"no message received since {last_heard_at:%Y-%m-%d %H:%M} UTC"
    return RuleFinding(subject=Subject(vehicle=vehicle, rule=AlarmRule.SILENCE), is_wrong=is_wrong, reason=reason)


def quota_findings(withheld: Mapping[str, int], open_subjects: Iterable[Subject]) -> Iterator[RuleFinding]:
    """Yield of which vehicles messages of today were withheld, and of which no longer."""
    alarmed = {subject.vehicle for subject in open_subjects if subject.rule is AlarmRule.QUOTA}
    for vehicle in sorted(withheld.keys() | alarmed):
        count = withheld.get(vehicle, 0)
        reason = f"{count} messages of today are beyond its quota; the vehicle keeps them and sends them again"
        yield RuleFinding(subject=Subject(vehicle=vehicle, rule=AlarmRule.QUOTA), is_wrong=count > 0, reason=reason)


def retired_findings(open_subjects: Iterable[Subject]) -> Iterator[RuleFinding]:
    """Yield that alarms of a rule that is no more are over."""
    for subject in open_subjects:
        if subject.rule is AlarmRule.CORRECTION:
            yield RuleFinding(subject=subject, is_wrong=False, reason="nothing is told of it any more")


def transitions(
    findings: Iterable[RuleFinding], open_subjects: Container[Subject], now: datetime
) -> Iterator[Transition]:
    """Yield which alarms are raised and which are cleared, by findings and by the alarms that are open."""
    for finding in findings:
        if finding.is_wrong is None or finding.is_wrong == (finding.subject in open_subjects):
            continue
        event = AlarmEvent.RAISED if finding.is_wrong else AlarmEvent.CLEARED
        yield Transition(subject=finding.subject, event=event, reason=finding.reason, at=now)


def _subject(clutch: ClutchNow, rule: AlarmRule) -> Subject:
    return Subject(vehicle=clutch.vehicle, clutch=clutch.clutch, element=clutch.element, rule=rule)


def _beyond(value: float, begin: float, end: float) -> bool | None:
    if value >= begin:
        return True
    return False if value <= end else None
