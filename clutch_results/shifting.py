"""How a vehicle shifts, by speeds and torques alone: what each kind of event is like, and how that changes.

What is told of a vehicle whose signals do not suffice for friction. Like is compared with like: events of one kind
between the same gears, where there are enough of them by the oil's temperature, the car's acceleration and the speed
that the clutch had to bridge.

    summary = shifting_of(results)        # of one vehicle, the oldest first, as they are stored
    shifting_words(summary)               # one sentence for people, beginning with "shifting: "
    unknown_friction_words(summary)       # the same behind "Friction: cannot be known from this car; "
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from statistics import fmean, stdev
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from clutch_model.units import NS_PER_S
from clutch_results.event_kinds import DATED_NS, EventKind, events_text
from clutch_results.measures import BY_KEY, DRIVEN, MEASURES, OIL, SCORE, EventCondition, Measure, shown_measures
from clutch_results.records import ShiftEstimate, ShiftResult, Tier, to_plain, utc_from_bus_ns
from clutchdiag_io.people import STDS, half_width, plus_minus
from fleet_contract import JsonObject

DRIVE_NS: Final = 3_600_000_000_000  # a pause of an hour ends a drive
LEAST_FREEDOM: Final = 2  # events beyond the numbers that a change is fitted with: fewer tell no scatter
EVENTS_PER_NUMBER: Final = 4  # of a fit, before one more condition is taken into account
DRIVES_DIFFER_RATIO: Final = 0.05  # one deviation of the middles of drives of an unchanged vehicle [C]
DRIVES_KNOWN: Final = 4.0  # as many drives as that assumption is worth [C]
CLEAR_COUNT: Final = 4  # events of a kind that tell how much it scatters
KINDS_KNOWN: Final = 4  # as many events the scatter of the other kinds of event is worth, beside that of a kind [C]
LEAST_SCATTER: Final = 1e-3  # of events, over their size: no measure is known better
CHANCE: Final = 0.0455  # of a normal error beyond two deviations
MOST_NAMED: Final = 3  # changes in one sentence
_MONTH_DAYS: Final = 31
_NS_PER_DAY: Final = 86_400 * NS_PER_S
_MONTHS: Final = (
    *("January", "February", "March", "April", "May", "June"),
    *("July", "August", "September", "October", "November", "December"),
)
_LEAST_SPREAD: Final = 1e-9  # of a condition or a measure, over its size: less is none


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftingChange:
    """How a measure changed from the first to the last of some events, on a straight line through all of them."""

    change: float  # in the unit of its measure
    std_change: float  # two of them hold 95 of 100 truths, however few events there are
    change_ratio: float | None  # over the beginning; None where the measure is not well above zero
    std_change_ratio: float | None
    chance_probability: float  # that events which did not change scatter so much
    event_count: int
    drive_count: int  # 1: over a drive
    since_utc: str | None  # start of the first event, ISO 8601; None: it has no date
    until_utc: str | None  # of the last
    adjusted_for: tuple[str, ...] = ()  # conditions that were taken into account

    @property
    def is_seen(self) -> bool:
        """Whether it is beyond two deviations."""
        return abs(self.change) > STDS * self.std_change


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftingValue:
    """One measure of the events of a kind."""

    key: str  # of `MEASURES`
    mean: float
    std: float | None  # of the mean: by the scatter of events and by what their errors share; None: of one event
    scatter: float | None  # one deviation of single events; None: of one event
    event_count: int  # that tell it
    over_drive: ShiftingChange | None = None  # over the newest drive; None: too few events
    over_drives: ShiftingChange | None = None  # from the first drive to the newest


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftingRow:
    """What events of one kind between two gears are like; ``from_gear`` equals ``to_gear`` where none changes."""

    kind: EventKind
    from_gear: int
    to_gear: int
    event_count: int  # those that tell nothing included
    values: tuple[ShiftingValue, ...]  # what is measured; others are not

    @property
    def name(self) -> str:
        """The kind and the gears, for people."""
        gears = f"{self.from_gear}-{self.to_gear}" if self.from_gear != self.to_gear else str(self.to_gear)
        return f"{self.kind.value.replace('_', ' ')} {gears}"

    def value(self, measure: Measure) -> ShiftingValue | None:
        """Return what is known of a measure; None: it is not measured."""
        return next((value for value in self.values if value.key == measure.key), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class OverallChange:
    """How a measure changed in all events, each held against others of its kind and gears, as a ratio."""

    key: str
    over_drive: ShiftingChange | None
    over_drives: ShiftingChange | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftingSummary:
    """How a vehicle shifts: by kind of event and gears, and what changed over the newest drive and over all."""

    event_count: int
    drive_count: int
    tier: Tier | None  # of the newest event: what the vehicle's signals suffice for; None: there is no event
    rows: tuple[ShiftingRow, ...]  # by kind, in the order of `EventKind`, and gears
    overall: tuple[OverallChange, ...]  # of the measures of which a change can be told

    @property
    def commonest(self) -> ShiftingRow | None:
        """The row with the most events that tell something, gear changes first."""
        told = [row for row in self.rows if row.values]
        return max(told, key=lambda row: (row.from_gear != row.to_gear, row.event_count), default=None)


def shifting_of(results: Iterable[ShiftResult]) -> ShiftingSummary:
    """Return how a vehicle shifts, by results as they are stored: of one vehicle, the first to arrive first.

    Dates are taken as they are: who doubts them passes `clocks.chronicle_of(...).results`. Results without a date
    count as one drive a stream, in the order of their arrival. Pure; nothing is raised, whatever is measured.
    """
    drives = drives_of(results)
    events = [_Event(result.estimate, number) for number, drive in enumerate(drives) for result in drive]
    if not events:
        return ShiftingSummary(event_count=0, drive_count=0, tier=None, rows=(), overall=())
    groups: dict[tuple[EventKind, int, int], list[_Event]] = {}
    for event in events:
        estimate = event.estimate
        groups.setdefault((estimate.kind, estimate.from_gear, estimate.to_gear), []).append(event)
    order = {kind: place for place, kind in enumerate(EventKind)}
    ordered = sorted(groups.items(), key=lambda item: (order[item[0][0]], *item[0][1:]))
    usual = {measure.key: _usual_scatter(measure, list(groups.values())) for measure in MEASURES}
    rows = tuple(
        ShiftingRow(
            kind=kind,
            from_gear=from_gear,
            to_gear=to_gear,
            event_count=len(group),
            values=tuple(
                filter(None, (_value(measure, group, len(drives), usual[measure.key]) for measure in MEASURES))
            ),
        )
        for (kind, from_gear, to_gear), group in ordered
    )
    return ShiftingSummary(
        event_count=len(events),
        drive_count=len(drives),
        tier=events[-1].estimate.tier,
        rows=rows,
        overall=tuple(filter(None, (_overall(measure, groups.values(), len(drives)) for measure in MEASURES))),
    )


@dataclass(frozen=True, slots=True)
class _Event:
    estimate: ShiftEstimate
    drive: int  # from 0


@dataclass(frozen=True, slots=True)
class _Told:
    """A measure of one event; ``group`` numbers the kinds of event that are held against themselves only."""

    event: _Event
    value: float
    std: float | None
    group: int = 0


def drives_of(results: Iterable[ShiftResult]) -> list[list[ShiftResult]]:
    """Return results drive by drive, the earliest first: an hour's pause ends one, and so does a log without a date."""
    streams: dict[str, list[ShiftResult]] = {}
    for result in results:
        streams.setdefault(result.stream, []).append(result)
    drives: list[list[ShiftResult]] = []
    for stream in streams.values():
        for result in stream:
            gap_ns = None if result is stream[0] else result.estimate.start_ns - drives[-1][-1].estimate.end_ns
            if gap_ns is not None and gap_ns <= DRIVE_NS:
                drives[-1].append(result)
            else:
                drives.append([result])
    # What has no date stays where it arrived: sorting is stable.
    drives.sort(key=lambda drive: max(drive[0].estimate.start_ns, DATED_NS))
    joined: list[list[ShiftResult]] = []
    for drive in drives:
        start_ns = drive[0].estimate.start_ns
        end_ns = joined[-1][-1].estimate.end_ns if joined else 0
        if joined and end_ns >= DATED_NS and 0 <= start_ns - end_ns <= DRIVE_NS:  # a log that goes on in another
            joined[-1] += drive
        else:
            joined.append(list(drive))
    return joined


def _told(measure: Measure, group: Sequence[_Event], number: int = 0) -> list[_Told]:
    known = ((event, *measure.read(event.estimate)) for event in group)
    return [
        _Told(event, value, std, number) for event, value, std in known if value is not None and math.isfinite(value)
    ]


@dataclass(frozen=True, slots=True)
class _UsualScatter:
    """How much events of the other kinds scatter about the means of their kinds."""

    ratio: float  # one deviation over the mean of a kind
    least: float  # below which no mean counts: of what is about zero a ratio says nothing
    freedom: int  # on which that rests, at most `KINDS_KNOWN`

    def variance(self, mean: float) -> float:
        return (self.ratio * max(abs(mean), self.least)) ** 2


def _usual_scatter(measure: Measure, groups: Sequence[Sequence[_Event]]) -> _UsualScatter:
    kinds = [np.array([one.value for one in _told(measure, group)]) for group in groups]
    least = 0.5 * float(np.median([abs(kind.mean()) for kind in kinds if kind.size] or [0.0]))
    several = [kind for kind in kinds if kind.size > 1 and least > 0.0]
    squares = [float(np.var(kind, ddof=1)) / max(abs(kind.mean()), least) ** 2 for kind in several]
    sizes = [kind.size for kind in several]
    # Launches scatter as nothing else does: the middle kind stands for the others, of those that tell their scatter.
    clear = [square for square, size in zip(squares, sizes, strict=True) if size >= CLEAR_COUNT] or squares
    freedom = sum(size - 1 for size in sizes)
    return _UsualScatter(math.sqrt(float(np.median(clear or [0.0]))), least, min(freedom, KINDS_KNOWN))


def _value(measure: Measure, group: Sequence[_Event], drive_count: int, usual: _UsualScatter) -> ShiftingValue | None:
    told = _told(measure, group)
    if not told:
        return None
    mean, scatter = fmean(one.value for one in told), _scatter(told)
    return ShiftingValue(
        key=measure.key,
        mean=mean,
        std=_std_of_mean(told, mean, scatter, usual),
        scatter=scatter,
        event_count=len(told),
        over_drive=_over_drive(measure, told, drive_count),
        over_drives=_over_drives(measure, told),
    )


def _scatter(told: Sequence[_Told]) -> float | None:
    return stdev(one.value for one in told) if len(told) > 1 else None


def _std_of_mean(told: Sequence[_Told], mean: float, scatter: float | None, usual: _UsualScatter) -> float | None:
    """Return the deviation of a mean: the scatter averages out, what the errors of all events share does not.

    Two or three events hardly tell their scatter: that of the other kinds counts beside it, as a few events would.
    """
    own = [one.std for one in told if one.std is not None]
    if scatter is None:
        return own[0] if own else None
    freedom = len(told) - 1
    variance = (freedom * scatter**2 + usual.freedom * usual.variance(mean)) / (freedom + usual.freedom)
    shared = max(fmean(std**2 for std in own) - variance, 0.0) if len(own) == len(told) else 0.0
    return math.sqrt(variance * _width(freedom + usual.freedom) ** 2 / len(told) + shared)


def _overall(measure: Measure, groups: Iterable[Sequence[_Event]], drive_count: int) -> OverallChange | None:
    """Return the change of a measure in all kinds of event, each over the mean of its kind."""
    told: list[_Told] = []
    for number, group in enumerate(groups):
        known = _told(measure, group, number)
        mean, scatter = fmean([one.value for one in known] or [0.0]), _scatter(known)
        if scatter is not None and mean > scatter:  # of what is about zero a ratio says nothing
            told += [replace(one, value=one.value / mean) for one in known]
    over_drive, over_drives = _over_drive(measure, told, drive_count), _over_drives(measure, told)
    if over_drive is None and over_drives is None:
        return None
    return OverallChange(key=measure.key, over_drive=over_drive, over_drives=over_drives)


def _over_drive(measure: Measure, told: Sequence[_Told], drive_count: int) -> ShiftingChange | None:
    """Return the change over the newest drive; that oil warms is a part of it."""
    newest = [one for one in told if one.event.drive == drive_count - 1]
    starts_s = np.array([one.event.estimate.start_ns / NS_PER_S for one in newest])
    return _change(measure, newest, starts_s, DRIVEN)


def _over_drives(measure: Measure, told: Sequence[_Told]) -> ShiftingChange | None:
    """Return the change from the first drive to the newest, by their dates, without these by their order."""
    if len({one.event.drive for one in told}) < 2:
        return None
    begins: dict[int, int] = {}
    for one in told:
        begins.setdefault(one.event.drive, one.event.estimate.start_ns)
    is_dated = min(begins.values()) >= DATED_NS and len(set(begins.values())) == len(begins)
    place = {drive: begin / _NS_PER_DAY if is_dated else float(drive) for drive, begin in begins.items()}
    return _change(measure, told, np.array([place[one.event.drive] for one in told]), (OIL, *DRIVEN))


def _change(
    measure: Measure, told: Sequence[_Told], at: FloatArray, conditions: Sequence[EventCondition]
) -> ShiftingChange | None:
    """Return the change of a measure along ``at``, shape (n,); None: too few events, or all at once."""
    value = np.array([one.value for one in told])
    if len(told) < 2 + LEAST_FREEDOM or not np.ptp(at) > 0.0 or not value.any():
        return None
    _, group = np.unique([one.group for one in told], return_inverse=True)
    drives, drive = np.unique([one.event.drive for one in told], return_inverse=True)
    along = (at - at.min()) / np.ptp(at)
    columns, names = [along], list[str]()
    for condition in conditions:
        known = [condition.read(one.event.estimate) for one in told] if measure.key not in condition.not_for else [None]
        is_room = len(told) >= EVENTS_PER_NUMBER * (int(group.max()) + 2 + len(columns))
        if is_room and None not in known:
            column = np.array(known, np.float64)
            if np.ptp(column) > _LEAST_SPREAD * np.abs(column).max():
                columns.append((column - column.mean()) / column.std())
                names.append(condition.name)
    line = _line(value, np.column_stack(columns), group, drive, len(drives))
    if line is None:
        return None
    from scipy.special import stdtr  # noqa: PLC0415 - a large library

    change, std, freedom = line
    begin, middle = float(value.mean() - change * along.mean()), float(along.mean())
    std_begin = math.hypot(float(value.std()) / math.sqrt(len(told)), middle * std)
    is_ratio = begin > STDS * std_begin
    ratio = change / begin if is_ratio else 0.0
    var_ratio = max(std**2 + (ratio * std_begin) ** 2 + 2.0 * ratio * middle * std**2, std**2) / begin**2
    ends = sorted(one.event.estimate.start_ns for one in told)
    since, until = (utc_from_bus_ns(t_ns) if ends[0] >= DATED_NS else None for t_ns in (ends[0], ends[-1]))
    width = _width(freedom)
    return ShiftingChange(
        change=change,
        std_change=width * std,
        change_ratio=ratio if is_ratio else None,
        std_change_ratio=width * math.sqrt(var_ratio) if is_ratio else None,
        chance_probability=float(2.0 * stdtr(freedom, -abs(change) / std)) if std > 0.0 else float(change == 0.0),
        event_count=len(told),
        drive_count=len(drives),
        since_utc=since,
        until_utc=until,
        adjusted_for=tuple(names),
    )


def _line(
    value: FloatArray, columns: FloatArray, group: Int64Array, drive: Int64Array, drive_count: int
) -> tuple[float, float, int] | None:
    """Return the slope along the first column, its deviation and degrees of freedom; None: it cannot be told.

    Generalised least squares with a constant for each group and a random effect for each drive (Laird and Ware,
    Biometrics 38 (1982)): drives differ by traffic and driver, so many events of a few drives tell no more than these.
    The variance among drives is that of the data and of what is assumed, by how many drives each rests on.
    """
    design = np.column_stack((columns, np.equal.outer(group, np.arange(group.max() + 1)).astype(np.float64)))
    freedom = len(value) - design.shape[1]
    if freedom < LEAST_FREEDOM or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    rest = value - design @ np.linalg.lstsq(design, value, rcond=None)[0]
    count = np.bincount(drive, minlength=drive_count)
    rest_of_drive = np.bincount(drive, rest, drive_count) / count
    within = rest - rest_of_drive[drive] if drive_count > 1 else rest
    inner = max(freedom - drive_count + 2, 1) if drive_count > 1 else freedom
    variance = max(float(within @ within) / inner, (LEAST_SCATTER * float(np.abs(value).max())) ** 2)
    among = 0.0
    if drive_count > 1:
        assumed = (DRIVES_DIFFER_RATIO * float(np.abs(value.mean()))) ** 2
        observed = max(float(rest_of_drive @ rest_of_drive) - variance * float((1.0 / count).sum()), 0.0)
        among = (DRIVES_KNOWN * assumed + observed) / (DRIVES_KNOWN + drive_count - 2)
        freedom = min(freedom, int(DRIVES_KNOWN) + drive_count - 2)
    sums = np.zeros((drive_count, design.shape[1]))
    np.add.at(sums, drive, design)
    totals, shrink = np.bincount(drive, value, drive_count), among / (variance + count * among)
    normal = (design.T @ design - sums.T @ (shrink[:, np.newaxis] * sums)) / variance
    right = (design.T @ value - sums.T @ (shrink * totals)) / variance
    covariance = np.linalg.inv(normal)
    return float(covariance[0] @ right), math.sqrt(max(float(covariance[0, 0]), 0.0)), freedom


def _width(freedom: int) -> float:
    """Return by how much a deviation of few degrees of freedom is widened, so that two hold 95 of 100 truths."""
    from scipy.special import stdtrit  # noqa: PLC0415 - a large library

    return max(float(stdtrit(freedom, 1.0 - CHANCE / 2.0)) / STDS, 1.0)


def change_words(measure: Measure, change: ShiftingChange) -> str:
    """Return a change for people: ``slip time 18 ± 6 % longer than in March``; ``slip time ± 6 %`` if none is seen."""
    if not change.is_seen:
        return f"{measure.name} ± {_amount(measure, change, is_width=True)}"
    direction = measure.more if change.change > 0.0 else measure.less
    when = "at the end of the drive" if change.drive_count == 1 else f"than {since_words(change)}"
    return f"{measure.name} {_amount(measure, change)} {direction} {when}"


def _amount(measure: Measure, change: ShiftingChange, *, is_width: bool = False) -> str:
    """Return the size of a change with two deviations, or these alone, in percent where that says something."""
    if change.change_ratio is not None and change.std_change_ratio is not None and measure is not SCORE:
        value, std, scale, form, unit = change.change_ratio, change.std_change_ratio, 100.0, "{:.0f}", "%"
    else:
        value, std, scale, form, unit = change.change, change.std_change, measure.scale, measure.form, measure.unit
    unit = "points" if measure is SCORE else unit
    text = half_width(std, form, scale=scale) if is_width else plus_minus(abs(value), std, form, scale=scale)
    return f"{text} {unit}".rstrip()


CHANGE_LEGEND: Final = "none: no change beyond these; ?: may be chance, among so many"


def percent_words(measure: Measure, change: ShiftingChange) -> str:
    """Return a change as a cell of a table: with its sign and two deviations; ``none`` and these if it is not seen."""
    if not change.is_seen:
        return f"none ± {_amount(measure, change, is_width=True)}"
    return f"{'+' if change.change > 0.0 else '-'}{_amount(measure, change)}"


def change_cell(summary: ShiftingSummary, value: ShiftingValue | OverallChange | None) -> str:
    """Return the newest change of a value as a cell of a table; `CHANGE_LEGEND` says how to read it."""
    change = None if value is None else newest_change(summary, value)
    if value is None or change is None:
        return "-"
    doubt = " ?" if change.is_seen and not is_sure(summary, change) else ""
    return f"{percent_words(BY_KEY[value.key], change)}{doubt}"


def since_words(change: ShiftingChange) -> str:
    """Return when the events begin against which a change is told: ``in March``, ``on 4 May``, ``in the first drive``.

    The year is said where it is not that of the last event.
    """
    if change.since_utc is None or change.until_utc is None:
        return "in the first drive"
    first, last = (datetime.fromisoformat(text).astimezone(UTC) for text in (change.since_utc, change.until_utc))
    year = f" {first.year}" if first.year != last.year else ""
    month = _MONTHS[first.month - 1]
    return f"in {month}{year}" if (last - first).days > _MONTH_DAYS else f"on {first.day} {month}{year}"


def is_sure(summary: ShiftingSummary, change: ShiftingChange) -> bool:
    """Return whether a change is seen though so many were looked at, by Bonferroni's bound.

    Of a hundred that are looked at five are beyond two deviations by chance.
    """
    return change.is_seen and change.chance_probability * len(_looked_at(summary)) < CHANCE


def _looked_at(summary: ShiftingSummary) -> list[tuple[Measure, ShiftingChange, str, bool]]:
    """Return all changes that can be told, of what each is, and whether it is of all events."""
    overall = [
        (measure, change, f"{measure.name} of all events", True) for measure, change in _overall_changes(summary)
    ]
    rows = [
        (BY_KEY[value.key], change, f"{row.name} {BY_KEY[value.key].name}", False)
        for row in summary.rows
        for value in row.values
        if (change := newest_change(summary, value)) is not None
    ]
    return [*overall, *rows]


def seen_changes(summary: ShiftingSummary) -> list[str]:
    """Return for people which changes are surely seen: those of all events before single kinds, the surest first."""
    looked_at = _looked_at(summary)
    sure = [each for each in looked_at if each[1].is_seen and each[1].chance_probability * len(looked_at) < CHANCE]
    told = {measure.key for measure, *_, is_of_all in sure if is_of_all}
    named = sorted((each for each in sure if each[3] or each[0].key not in told), key=_order)
    return [f"{name}{change_words(measure, change).removeprefix(measure.name)}" for measure, change, name, _ in named]


def _order(each: tuple[Measure, ShiftingChange, str, bool]) -> tuple[bool, float]:
    return not each[3], each[1].chance_probability


def newest_change(summary: ShiftingSummary, value: ShiftingValue | OverallChange) -> ShiftingChange | None:
    """Return the change that is told: from the first drive to the newest, or over the only one."""
    return value.over_drives if summary.drive_count > 1 else value.over_drive


def _overall_changes(summary: ShiftingSummary) -> list[tuple[Measure, ShiftingChange]]:
    known = ((BY_KEY[value.key], newest_change(summary, value)) for value in summary.overall)
    return [(measure, change) for measure, change in known if change is not None]


def shifting_words(summary: ShiftingSummary) -> str:
    """Return one sentence for people, without a full stop: ``shifting: 74 events; ...``.

    It says how many events there were, what those of the commonest kind are like, and what changed since the first
    drive, or over the only one; if no change is seen, how large one might be.
    """
    if not summary.event_count:
        return "shifting: no event was seen"
    drives = f" in {summary.drive_count} drives" if summary.drive_count > 1 else ""
    parts = [f"{events_text(summary.event_count)}{drives}"]
    if (row := summary.commonest) is not None:
        values = [(measure, row.value(measure)) for measure in shown_measures(summary.tier)]
        told = ", ".join(f"{measure.name} {measure.words(at.mean, at.std)}" for measure, at in values if at is not None)
        parts += [f"{row.name} ({row.event_count}): {told}"] if told else []
    changes = _overall_changes(summary)
    if seen := seen_changes(summary):
        parts += seen[:MOST_NAMED]
    elif changes:
        shown = [change for change in changes if change[0] in shown_measures(summary.tier)] or changes
        measure, change = shown[0]
        since = "over the drive" if change.drive_count == 1 else f"since {_since(change)}"
        parts.append(f"no change seen {since} ({measure.name} ± {_amount(measure, change, is_width=True)})")
    else:
        parts.append("too few events of a kind to tell a change")
    return f"shifting: {'; '.join(parts)}"


def _since(change: ShiftingChange) -> str:
    return since_words(change).removeprefix("in ").removeprefix("on ")


def unknown_friction_words(summary: ShiftingSummary, *, is_relative: bool = False) -> str:
    """Return what a vehicle without friction can tell, as one sentence for people without a full stop.

    ``is_relative`` says that something else tells its friction up to a scale.
    """
    return f"Friction: {'its level ' if is_relative else ''}cannot be known from this car; {shifting_words(summary)}"


def shifting_record(summary: ShiftingSummary) -> JsonObject:
    """Return a summary as the JSON of a run has it; what is not measured is left out."""
    return {
        "event_count": summary.event_count,
        "drive_count": summary.drive_count,
        "rows": [
            {
                "kind": row.kind.value,
                "from_gear": row.from_gear,
                "to_gear": row.to_gear,
                "event_count": row.event_count,
                "measures": {value.key: _plain(value) for value in row.values},
            }
            for row in summary.rows
        ],
        "overall": {value.key: _plain(value) for value in summary.overall},
        "changes": seen_changes(summary),
    }


def _plain(value: ShiftingValue | OverallChange) -> JsonObject:
    """Return a record as JSON has it, without its key and what is not known."""
    return {name: each for name, each in to_plain(value).items() if name != "key" and each is not None}
