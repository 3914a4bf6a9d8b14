"""What a run did, in numbers: frames in, frames refused and why, shifts out. For people and for machines."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Self

from clutch_results.clocks import NO_TODAY, chronicle_of
from clutch_results.event_kinds import DATED_NS
from clutch_results.loads import Load
from clutch_results.records import (
    Causes,
    ClutchVerdict,
    Condition,
    FluidFill,
    FrictionTrend,
    Reason,
    ShiftResult,
    ShiftStatistics,
    Status,
    Tier,
    clutch_record,
    order_record,
    shift_record,
    to_plain,
    utc_from_bus_ns,
)
from clutch_results.shifting import ShiftingSummary, shifting_of, shifting_record, unknown_friction_words
from clutchdiag_io.people import STDS, half_width, plus_minus
from diag_service.diagnosis.capability import (
    FULL,
    LOCKUP_TIER_TEXT,
    NEEDS_HEAD,
    TIER_TEXT,
    TORQUE_TEXT,
    Capability,
    is_relative,
    need_lines,
)
from diag_service.diagnosis.condition.thresholds import Silence
from diag_service.diagnosis.condition.verdict import advice, likely
from diag_service.diagnosis.frame_counts import FrameCounts, with_reasons
from fleet_contract import JsonObject, orders

RENEWED_RATIO: Final = 0.08  # by which mu_C rises with one fluid at most; after a fill by 15 % and more
OTHER_CHANNEL = "other_channel"
OF_NO_MESSAGE = "remote_or_error"  # the only rejection that says nothing of a message


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameShare:
    """What became of some frames: ``frames = decoded + ignored + sum(rejected.values())``, to the frame."""

    frames: int  # that were looked at
    decoded: int
    ignored: int  # of messages that are not used
    rejected: Mapping[str, int] = field(default_factory=dict)  # reason -> frames


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelShare(FrameShare):
    """What one channel of a log gave."""

    channel: int  # as its log numbers it

    @property
    def is_passed_over(self) -> bool:
        """Whether messages that are wanted came here, and not one frame of them was used."""
        return not self.decoded and any(self.rejected[reason] for reason in self.rejected if reason != OF_NO_MESSAGE)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogShare(FrameShare):
    """What one log gave: the sum of its channels."""

    path: str
    channels: tuple[ChannelShare, ...]  # by number

    @classmethod
    def of(cls, path: str, channels: tuple[ChannelShare, ...]) -> Self:
        rejected: Counter[str] = Counter()
        for channel in channels:
            rejected.update(channel.rejected)
        frames, decoded, ignored = (
            sum(getattr(channel, name) for channel in channels) for name in ("frames", "decoded", "ignored")
        )
        return cls(frames=frames, decoded=decoded, ignored=ignored, rejected=rejected, path=path, channels=channels)

    @property
    def used_channels(self) -> tuple[int, ...]:
        return tuple(channel.channel for channel in self.channels if channel.decoded)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contributions:
    """What the logs of a drive gave."""

    logs: tuple[LogShare, ...] = ()  # none for a bus
    idle: tuple[str, ...] = ()  # what gave nothing, each on a line for people


NO_LOGS = Contributions()


def idle_lines(logs: Sequence[LogShare], named_channel: int | None) -> Iterator[str]:
    """Yield a line for each log of which not one frame was used, and for channels with wanted messages of each other.

    A profile that names its channel passes the others over on purpose; a log without the named one gives nothing.
    """
    for log in logs:
        if not log.decoded:
            yield f"{log.path} contributed nothing: {_log_fate(log, logs, named_channel)}"
        elif named_channel is None and (passed := tuple(channel for channel in log.channels if channel.is_passed_over)):
            more = f" and {len(passed) - 1} more" if len(passed) > 1 else ""  # a damaged log may have hundreds
            fate = _fate_text(LogShare.of(log.path, passed), "of messages that are followed elsewhere")
            yield f"channel {passed[0].channel}{more} of {log.path} contributed nothing: {fate}"


def log_record(log: LogShare) -> JsonObject:
    return {
        "path": log.path,
        "followed_channels": list(log.used_channels),
        **_counts(log),
        "channels": [{"channel": channel.channel, **_counts(channel)} for channel in log.channels],
    }


def _counts(share: FrameShare) -> JsonObject:
    return {member.name: getattr(share, member.name) for member in fields(FrameShare)}


def _log_fate(log: LogShare, logs: Sequence[LogShare], named_channel: int | None) -> str:
    """Return in words what became of the frames of a log of which none was used."""
    elsewhere = [channel for channel in log.channels if channel.rejected.get(OTHER_CHANNEL)]
    channels = {channel.channel for channel in elsewhere}
    if named_channel is not None:
        wanted = f"the profile names {named_channel}"
    else:
        used = {channel for other in logs for channel in other.used_channels}
        wanted = (
            f"the drive follows {_listed(used - channels)}"
            if used - channels
            else "the drive follows those of other logs"
        )
    return _fate_text(log, f"on another channel ({_listed(channels)}; {wanted})")


def _fate_text(share: FrameShare, elsewhere: str) -> str:
    counts = {elsewhere: share.rejected.get(OTHER_CHANNEL, 0), "of messages that are not used": share.ignored}
    counts |= {
        f"rejected: {reason.replace('_', ' ')}": count
        for reason, count in share.rejected.items()
        if reason != OTHER_CHANNEL
    }
    return ", ".join(f"{count} frames {words}" for words, count in counts.items() if count) or "no frame was read"


def _listed(channels: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(channels)))


if TYPE_CHECKING:  # a live service tells no friction up to a scale
    from diag_service.diagnosis.lockup.slip import LockupSlip
    from diag_service.diagnosis.lockup.slope import LockupSlope
    from diag_service.diagnosis.prediction import RelativeFriction

SUMMARY_SCHEMA = "clutchdiag/summary/v1"
_FRAME_KEYS = {"invalid": "invalid_signals"}  # public, where they are not the names of `FrameCounts`


class Gap(StrEnum):
    """Why a run has seen a part of its drive only."""

    STOPPED = "stopped_early"
    LOG_CUT = "log_cut"  # the file is cut off


GAP_TEXT = {Gap.STOPPED: "stopped early", Gap.LOG_CUT: "a log is cut off"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """The numbers of a run, at its end or on request."""

    vehicle: str
    frames: FrameCounts
    shifts: ShiftStatistics
    unpublished_count: int | None  # None without a broker
    capability: Capability = FULL
    gaps: tuple[Gap, ...] = ()  # why this is a part of the drive; none: it is the whole
    contributions: Contributions = NO_LOGS
    earlier: Mapping[int, ShiftResult] = field(default_factory=dict)  # by clutch, where this run has nothing later
    fluid: FluidFill | None = None  # that is in, if its fill is known
    loads: Mapping[int, Load] = field(default_factory=dict)  # what each clutch had to bear
    relative: "tuple[RelativeFriction, ...]" = ()  # of a log whose signals tell friction up to a scale
    lockup: "LockupSlope | None" = None  # of a log whose signals tell no level of a lock-up clutch
    lockup_slip: "LockupSlip | None" = None  # of a log that tells the slip of a lock-up clutch and no more
    held_run: str = ""  # what a clutch carried in a log in one gear, for people
    untold: tuple[ShiftResult, ...] = ()  # the newest results of a vehicle whose signals do not tell friction
    today_ns: int = NO_TODAY  # when the run was summed up, since 1970

    @property
    def latest(self) -> tuple[ShiftResult, ...]:
        """The last result of each clutch, clutch 1 first; of a part of a drive and of old fluid none has a verdict."""
        newest = (unjudged(result, self.gaps) for _, result in sorted(self.shifts.latest.items()))
        return of_present_fluid(newest, self.fluid, self.today_ns)

    @property
    def shifting(self) -> ShiftingSummary | None:
        """How a vehicle shifts whose signals do not tell friction; None: they do, or there was no event."""
        return shifting_of(self.untold) if self.untold else None

    @property
    def order(self) -> orders.Order:
        """What the vehicle is told, by the last result of each clutch, earlier runs counted."""
        known = {**{result.verdict.clutch: result for result in self.latest}, **self.earlier}
        elements, lockup = self.capability.elements, self.lockup or self.lockup_slip
        return order_by(known.values(), self.fluid, elements, lockup, today_ns=self.today_ns)


def latest_of(results: Iterable[ShiftResult], today_ns: int = NO_TODAY) -> tuple[ShiftResult, ...]:
    """Return the last result of each clutch, clutch 1 first: by the end of its event, without a date by its place.

    Where dates cannot be believed on a day the odometer decides.
    """
    latest, last_ns = dict[int, ShiftResult](), dict[int, int]()
    results = tuple(results)
    for result, dated in zip(results, chronicle_of(results, (), today_ns).results, strict=True):
        clutch, end_ns = result.estimate.clutch, dated.estimate.end_ns
        if end_ns < DATED_NS or end_ns >= last_ns.get(clutch, 0):
            latest[clutch] = result
        last_ns[clutch] = max(end_ns, last_ns.get(clutch, 0))
    return tuple(result for _, result in sorted(latest.items()))


def with_revisions(results: Iterable[ShiftResult]) -> list[ShiftResult]:
    """Return results of one vehicle, the oldest first, each as later ones have judged it."""
    revised, places = list(results), dict[tuple[int, int], int]()
    for place, result in enumerate(revised):
        for revision in result.estimate.revisions:
            if (earlier := places.get((revision.clutch, revision.end_bus_ns))) is not None:
                estimate = replace(
                    revised[earlier].estimate,
                    status=revision.status,
                    reasons=revision.reasons,
                    friction=revision.friction,
                    scale_free=revision.scale_free,
                    slope=revision.slope,
                )
                revised[earlier] = replace(revised[earlier], estimate=estimate)
        places[result.estimate.clutch, result.estimate.end_ns] = place
    return revised


def unjudged(result: ShiftResult, gaps: tuple[Gap, ...]) -> ShiftResult:
    """Return a result without its verdict if there are gaps: a part of a drive may say the opposite of the whole."""
    if not gaps:
        return result
    verdict = replace(
        result.verdict,
        condition=Condition.NO_VERDICT,
        reason=gaps_line(gaps),
        advice=advice(result.verdict.clutch, Silence.PART_OF_DRIVE, element=result.verdict.element),
        causes=None,
    )
    return replace(result, verdict=verdict)


def newest_causes(results: Iterable[ShiftResult], today_ns: int = NO_TODAY) -> Causes | None:
    """Return what is known last of why a vehicle is as it is; its order goes by the same result."""
    newest = max(chronicle_of(results, (), today_ns).results, key=lambda result: result.estimate.end_ns, default=None)
    return None if newest is None else newest.verdict.causes


def cause_lines(causes: Causes | None) -> list[str]:
    """Return for people why a vehicle is as it is, what that rests on, what to do, and what would tell more."""
    if causes is None:
        return []
    suspects = ", ".join(
        f"{orders.cause_words(cause.cause, cause.clutch)} {100.0 * cause.probability:.0f} %"
        for cause in causes.likely[:3]
    )
    lines = [
        f"Why: {suspects} (by {causes.event_count} events).",
        f"  {causes.likely[0].evidence}",
        f"  {causes.advice}",
    ]
    return lines if causes.test is None else [*lines, f"  {causes.test}"]


def of_present_fluid(
    results: Iterable[ShiftResult], fluid: FluidFill | None, today_ns: int = NO_TODAY
) -> tuple[ShiftResult, ...]:
    """Return the last results of clutches; those of an earlier fluid without what they say of that."""
    results, filled_at = tuple(results), None if fluid is None else datetime.fromisoformat(fluid.filled_at)
    dated = chronicle_of(results, _fills(fluid), today_ns).results
    return tuple(_of_fluid(*pair, filled_at) for pair in zip(results, dated, strict=True))


def of_own_fluid(
    results: Iterable[ShiftResult], fills: Sequence[FluidFill], today_ns: int = NO_TODAY
) -> list[ShiftResult]:
    """Return results without what they say of a fluid before their own: a fill that is noted late finds such ones."""
    results, moments = tuple(results), [datetime.fromisoformat(fill.filled_at) for fill in fills]
    dated = chronicle_of(results, fills, today_ns).results
    filled = (max((at for at in moments if at < _end_at(result)), default=None) for result in dated)
    return [_of_fluid(*trio) for trio in zip(results, dated, filled, strict=True)]


def _fills(fluid: FluidFill | None) -> tuple[FluidFill, ...]:
    return () if fluid is None else (fluid,)


def _of_fluid(result: ShiftResult, dated: ShiftResult, filled_at: datetime | None) -> ShiftResult:
    """Return a result without what it says of an earlier fluid; ``dated`` is the same by a date to be believed."""
    if not orders.is_of_earlier_fluid(_end_at(dated), filled_at, _since_at(dated)):
        return result
    verdict = ClutchVerdict(
        clutch=result.verdict.clutch,
        condition=Condition.NO_VERDICT,
        reason=orders.UNKNOWN_FLUID,
        level_ratio=None,
        friction=None,
        shift_count=0,
        advice=orders.unseen_since_new(result.verdict.clutch, result.verdict.element),
        element=result.verdict.element,
        running_since_bus_ns=result.verdict.running_since_bus_ns,
    )
    return replace(result, verdict=verdict)


def _end_at(result: ShiftResult) -> datetime:
    return datetime.fromisoformat(utc_from_bus_ns(result.estimate.end_ns))


def _since_at(result: ShiftResult) -> datetime | None:
    since_ns = result.verdict.running_since_bus_ns
    return None if since_ns is None else datetime.fromisoformat(utc_from_bus_ns(since_ns))


def order_by(
    results: Iterable[ShiftResult],
    fluid: FluidFill | None,
    elements: Iterable[str] = (),
    lockup: "LockupSlope | LockupSlip | None" = None,
    *,
    today_ns: int = NO_TODAY,
    doubts: Sequence[str] = (),
) -> orders.Order:
    """Return the order for a vehicle by the last result of each clutch and the fluid that is in.

    ``doubts`` say of more results than these why their dates cannot be believed on a day.
    """
    chronicle = chronicle_of(results, _fills(fluid), today_ns)
    findings = [
        orders.ClutchFinding(
            clutch=result.verdict.clutch,
            element=result.verdict.element,
            condition=result.verdict.condition.name.lower(),
            text=result.verdict.advice,
            reason=result.verdict.reason,
            end_at=_end_at(result),
            since_at=_since_at(result),
            is_renewed=_is_renewed(result.verdict.trend),
            suspects=tuple(
                orders.Suspect(likely.cause, likely.clutch, likely.probability)
                for likely in (() if result.verdict.causes is None else result.verdict.causes.likely)
            ),
        )
        for result in chronicle.results
    ]
    order = orders.order_of(findings, None if fluid is None else datetime.fromisoformat(fluid.filled_at), elements)
    order = replace(order, notes=(*order.notes, *(doubts or chronicle.doubts)))
    if findings or lockup is None:
        return order
    if not lockup.withheld:
        return replace(order, sentence=orders.UNKNOWABLE[orders.UNTOLD], reasons=())
    return replace(order, sentence=orders.SLOPE_ALONE, reasons=(lockup.withheld,))


def _is_renewed(since: FrictionTrend | None) -> bool:
    return since is not None and since.change_mu_c_ratio > RENEWED_RATIO + STDS * since.std_change_mu_c_ratio


def gaps_line(gaps: tuple[Gap, ...]) -> str:
    """Return why there is no verdict, for people; empty if nothing is missing."""
    if not gaps:
        return ""
    return f"{', '.join(GAP_TEXT[gap] for gap in gaps)}: only a part of the drive was read, which gets no verdict"


def summary_record(summary: Summary) -> JsonObject:
    """Return the numbers as the final JSON object of a run."""
    frames = {_FRAME_KEYS.get(name, name): value for name, value in to_plain(summary.frames).items()}
    for own in ("invalid_at_first", "content"):  # for people
        del frames[own]
    capability = to_plain(summary.capability)
    del capability["elements"]  # results have them
    for name in ("needs", "absent"):
        if not capability[name]:
            del capability[name]
    if not summary.capability.torque.is_modelled:  # the tier says it
        del capability["torque"]
    return {
        "schema": SUMMARY_SCHEMA,
        "vehicle": summary.vehicle,
        "complete": not summary.gaps,
        "incomplete": [gap.value for gap in summary.gaps],
        "frames": frames,
        "shifts": {
            "by_status": dict(summary.shifts.by_status),
            "by_reason": dict(summary.shifts.by_reason),
            "stored": summary.shifts.stored_count,
            "already_stored": summary.shifts.known_count,
            "unpublished": summary.unpublished_count,
        },
        **order_record(summary.order),
        "clutches": [clutch_record(shift_record(result), summary.order) for result in summary.latest],
        "capability": capability,
        **({} if (shifting := summary.shifting) is None else {"shifting": shifting_record(shifting)}),
        **({"loads": [to_plain(load) for _, load in sorted(summary.loads.items())]} if summary.loads else {}),
        **({"relative_friction": [to_plain(friction) for friction in summary.relative]} if summary.relative else {}),
        **({} if summary.lockup is None else {"lockup_slope": to_plain(summary.lockup)}),
        **({} if summary.lockup_slip is None else {"lockup_slip": to_plain(summary.lockup_slip)}),
        **({"held_run": summary.held_run} if summary.held_run else {}),
        "logs": [log_record(log) for log in summary.contributions.logs],
        "idle": list(summary.contributions.idle),
    }


def reason_text(reason: str) -> str:
    """Return the value of a reason for people."""
    return "frames late" if reason == Reason.TIME_UNSURE else reason.replace("_", " ")


def shifts_line(summary: Summary) -> str:
    """Return the shift numbers as one line for people."""
    by_status, by_reason = dict(summary.shifts.by_status), dict(summary.shifts.by_reason)
    total = sum(by_status.values())
    if summary.untold:  # that friction is not told is said of the vehicle
        by_status.pop(Status.UNOBSERVED, None)
        by_reason.pop(Reason.SIGNAL_MISSING, None)
    parts = [with_reasons(f"{total} shifts", by_status)]
    if any(by_reason.values()):
        parts.append(with_reasons("reasons", {reason_text(reason): n for reason, n in by_reason.items()}))
    if summary.shifts.known_count:
        parts.append(f"{summary.shifts.known_count} were stored before")
    if summary.unpublished_count:
        parts.append(f"{summary.unpublished_count} wait for the broker")
    return ", ".join(parts)


def shifting_lines(summary: Summary) -> list[str]:
    """Return for people what a vehicle without friction tells instead, and what friction would need."""
    known = summary.shifting
    needs = list(need_lines(summary.capability))
    words = [] if known is None else [f"{unknown_friction_words(known, is_relative=is_relative(summary.untold))}."]
    return [*words, *([f"{NEEDS_HEAD}:", *(f"  {need}" for need in needs)] if needs else [])]


def capability_line(summary: Summary) -> str:
    """Return one line for people: what the signals suffice for and what is missing; empty where all is there.

    What friction lacks stands in `shifting_lines` where it is known signal by signal.
    """
    capability = summary.capability
    has_shifts = any(summary.shifts.by_status.values())
    if not has_shifts and not summary.frames.on_bus:
        return "no frame came: check the channel, the bit rate, and whether the ignition is on"
    parts = [] if has_shifts or summary.lockup or summary.lockup_slip else ["no shift was found"]
    if capability.tier is Tier.FRICTION and capability.torque.is_modelled:
        parts.append(TORQUE_TEXT[capability.torque])
    if capability.tier is Tier.FRICTION and has_shifts:
        return "; ".join(parts)
    if capability.tier is None:
        shown = "show that gears change, and no more" if has_shifts else "do not show shifts"
        parts.append(f"the signals {shown}: {capability.missing}")
    elif capability.tier is not Tier.FRICTION:
        text = (LOCKUP_TIER_TEXT if capability.elements else TIER_TEXT)[capability.tier]
        lacks = "" if capability.needs and has_shifts else f": {capability.missing}"
        parts.append(f"tier {capability.tier:d} of 3, {text}{lacks}")
    if capability.unseen:
        parts.append(f"mapped by profile {capability.profile}, but never seen: {', '.join(capability.unseen)}")
    return "; ".join(parts)


def slope_line(verdict: ClutchVerdict) -> str:
    """Return what is known of a clutch up to a scale, as one line for people; empty where the level is known, too."""
    free, slope = verdict.scale_free, verdict.slope
    if free is None or slope is None:
        return ""
    return (
        f"up to a scale mu_C {plus_minus(free.mu_c, free.std_mu_c)}; mu_S/mu_C "
        f"{plus_minus(slope.mu_s_ratio, slope.std_mu_s_ratio, '{:.3f}')}, "
        f"a falling slope is {likely(slope.probability_negative)}"
    )


def scale_free_lines(verdict: ClutchVerdict) -> Iterator[str]:
    """Yield for people what is known of a clutch without knowing the common scale, as far as it is."""
    free, scatter, since = verdict.scale_free, verdict.shift_scatter, verdict.trend
    if free is not None and verdict.common_scale_std_ratio is not None:
        yield (
            f"scale-free mu_C {plus_minus(free.mu_c, free.std_mu_c)}, mu_S {plus_minus(free.mu_s, free.std_mu_s)}; "
            f"common scale ± {half_width(verdict.common_scale_std_ratio, '{:.1f}', scale=100.0)} %"
        )
    if scatter is not None:
        widths = f"mu_C ± {half_width(scatter.std_mu_c)}, mu_S ± {half_width(scatter.std_mu_s)}"
        yield f"scatter from shift to shift {widths} ({scatter.shift_count} shifts)"
    if since is not None:
        yield (
            f"trend mu_C {_change(since.change_mu_c_ratio, since.std_change_mu_c_ratio)}, "
            f"mu_S {_change(since.change_mu_s_ratio, since.std_change_mu_s_ratio)} "
            f"against the baseline ({since.baseline_shift_count} shifts)"
        )


def ratio_line(summary: Summary) -> str:
    """Return the friction of clutch 1 over that of clutch 2 as one line for people; empty unless both are known."""
    newest = max(summary.latest, key=lambda result: result.estimate.end_ns, default=None)
    ratio = None if newest is None else newest.verdict.clutch_ratio
    if ratio is None:
        return ""
    return (
        f"mu_C1/mu_C2 {plus_minus(ratio.mu_c_ratio, ratio.std_mu_c_ratio, '{:.3f}')}, "
        f"mu_S1/mu_S2 {plus_minus(ratio.mu_s_ratio, ratio.std_mu_s_ratio, '{:.3f}')}"
    )


def _change(ratio: float, std_ratio: float) -> str:
    return plus_minus(ratio, std_ratio, "{:+.1f}", scale=100.0) + " %"
