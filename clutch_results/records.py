"""What the service says of a shift, and the public, versioned JSON of it: shift results, clutch states, service status.

SI units, radians, kelvin and pascal throughout. Times are bus times in integer nanoseconds since the epoch. Within a
version of the JSON keys are only ever added; a reader ignores those it does not know. ``fleet_contract`` holds the JSON
Schemas (2020-12) and the envelope in which records travel. Keys keep one order, so equal results are equal texts.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from enum import IntEnum, StrEnum
from functools import cache
from statistics import NormalDist
from typing import Any, Final, Self, TypeVar

import msgspec
import numpy as np

from clutch_model.calibration import TorqueSource
from clutch_results.event_kinds import EndReason, EventKind, MicroSlip, ShiftIndices, ShiftQuality
from clutchdiag_io.program import legible_record
from fleet_contract import Channel, JsonObject, ResultKey, schema
from fleet_contract.errors import ResultError
from fleet_contract.orders import Order

RecordT = TypeVar("RecordT")
LEAST_SLIP_ROWS = 5  # of a table, in a slip phase: three numbers of the balance, and two that hold them


def to_plain(record: object) -> JsonObject:
    """Return the fields of a record as plain values; floats survive the round trip bit by bit."""
    plain = msgspec.to_builtins(record, enc_hook=lambda v: dict(v) if isinstance(v, Mapping) else v.tolist())
    return {key: list(value) if isinstance(value, tuple) else value for key, value in plain.items()}


def from_plain(table: object, kind: type[RecordT]) -> RecordT:
    """Rebuild a record that `to_plain` made plain; unknown keys are ignored, missing ones take their defaults.

    Raises ValueError, which says which value cannot be one of the record.
    """
    return msgspec.convert(table, kind, dec_hook=lambda _, value: np.array(value, np.float64))


class Tier(IntEnum):
    """What the signals of a vehicle suffice for; a smaller number is more."""

    FRICTION = 1  # pressure and torques: mu
    TORQUE = 2  # torque only: transmitted over commanded clutch torque
    KINEMATIC = 3  # speeds and gears: shift time and slip


class Status(StrEnum):
    """What an estimate is worth."""

    VALID = "valid"
    REJECTED = "rejected"  # data that must not be used; the reasons say why
    UNOBSERVED = "unobserved"  # sound data without information on friction


class Reason(StrEnum):
    """Why a shift was rejected or carried no information."""

    INTERRUPTED = "interrupted"
    SIGNAL_MISSING = "signal_missing"
    FRAMES_MISSING = "frames_missing"
    NO_SLIP_WINDOW = "no_slip_window"
    FEW_SAMPLES = "few_samples"  # a table has too few rows in the slip
    TORQUE_UNKNOWN = "torque_unknown"  # the engine may have been asked for less, and the modelled torque does not tell
    MISFIT = "misfit"  # chi-square above the gate
    SENSOR_FROZEN = "sensor_frozen"  # a signal repeats a value while noise is expected
    SPEEDS_DISAGREE = "speeds_disagree"  # shafts that turn together read different speeds
    PRESSURE_OFF_COMMAND = "pressure_off_command"  # a loaded clutch's pressure is not the commanded one
    ZERO_JUMPED = "zero_jumped"  # an empty clutch's pressure reads something else than before
    OUT_OF_RANGE = "out_of_range"  # a signal outside the domain of the model
    NOT_UPDATED = "not_updated"  # sound, but the running state refused it
    E2E_INVALID = "e2e_invalid"  # a message that the estimate needs was not to be believed as a whole
    TIME_UNSURE = "time_unsure"  # frames came too late to say when they were sent
    SATURATED = "saturated"  # signals at the end of their scale
    IMPLAUSIBLE = "implausible"  # sensors contradict each other
    CALIBRATION_OLD = "calibration_old"
    NO_COMMON_TIME = "no_common_time"  # the samples of its signals have no stretch of time in common
    INTERNAL_ERROR = "internal_error"  # the program failed over it: nothing is said of it, nothing was learnt from it
    WHOLE_SECONDS = "times_in_whole_seconds"  # of many samples each: when in a second they were taken nobody knows
    LOW_DATA_QUALITY = "low_trust"  # each flaw alone would pass, together they do not


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionEstimate:
    """Friction coefficients of one clutch with their uncertainty.

    ``std_*`` are total standard deviations: random part and common scale (torque gain, inertia, piston area, ...).
    ``random_std_*`` leave the common scale out: they hold for trends and for the comparison of clutches.
    """

    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    correlation: float  # of the total errors of mu_c and mu_s
    random_std_mu_c: float
    random_std_mu_s: float
    slope_s_rad: float  # (mu_c - mu_s) / w_S: initial slope of the Stribeck curve
    std_slope_s_rad: float
    probability_negative_slope: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleFreeFriction:
    """Friction coefficients of one clutch times gain of the torque reading and piston area: what driving alone tells.

    The gain is reading over truth, the area a ratio to what the calibration says. Divided by both the numbers are the
    coefficients; the uncertainty of the two, the common scale, is not in ``std_*``. Of a modelled torque nobody knows
    the gain: the numbers are friction up to a scale.
    """

    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    correlation: float  # of the errors of mu_c and mu_s


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionSlope:
    """How the friction of one clutch goes with its slip, where its level is not known: no scale is in it."""

    torque: TorqueSource  # where that of the engine comes from
    mu_s_ratio: float  # mu_S over mu_C; above 1 friction falls with the slip
    std_mu_s_ratio: float
    probability_negative: float  # of a slope that falls

    @classmethod
    def of(cls, free: ScaleFreeFriction, torque: TorqueSource) -> Self:
        ratio = free.mu_s / free.mu_c
        part_c, part_s = free.std_mu_c / free.mu_c, free.std_mu_s / free.mu_s
        std = ratio * math.sqrt(max(part_c**2 + part_s**2 - 2.0 * free.correlation * part_c * part_s, 1e-12))
        # Of the difference, not of the ratio: a coefficient that is little known makes the latter lopsided.
        shared = free.correlation * free.std_mu_c * free.std_mu_s
        spread = math.sqrt(max(free.std_mu_c**2 + free.std_mu_s**2 - 2.0 * shared, 1e-12 * free.mu_c**2))
        negative = NormalDist(free.mu_c - free.mu_s, spread).cdf(0.0)
        return cls(torque=torque, mu_s_ratio=ratio, std_mu_s_ratio=std, probability_negative=negative)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftScatter:
    """How much the estimates of single shifts of one clutch scatter about the running one, outliers clipped."""

    std_mu_c: float
    std_mu_s: float
    shift_count: int  # shifts in it


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionTrend:
    """Change of the running friction of one clutch since its baseline; a wrong scale cancels in the ratios."""

    change_mu_c: float
    change_mu_s: float
    std_change_mu_c: float
    std_change_mu_s: float
    change_mu_c_ratio: float  # 0.01 is one percent more than in the baseline
    change_mu_s_ratio: float
    std_change_mu_c_ratio: float
    std_change_mu_s_ratio: float
    baseline_end_bus_ns: int  # end of the shift after which the baseline was frozen
    baseline_shift_count: int  # shifts in the baseline
    later_shift_count: int  # shifts used since


@dataclass(frozen=True, slots=True, kw_only=True)
class LiningChange:
    """Running friction of one clutch against that of its first fluid: what new fluid did not bring back."""

    change_mu_c_ratio: float  # -0.01 is one percent less than with the first fluid
    change_mu_s_ratio: float
    std_change_mu_c_ratio: float
    std_change_mu_s_ratio: float
    baseline_shift_count: int  # shifts in the baseline of the first fluid


@dataclass(frozen=True, slots=True, kw_only=True)
class StickSlip:
    """Launches of one clutch to lock, of the last twenty, and how many of them slipped again after they had stuck."""

    launch_count: int
    judder_count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchRatio:
    """Friction of clutch 1 over that of clutch 2; the torque gain cancels, the piston areas do not."""

    mu_c_ratio: float
    mu_s_ratio: float
    std_mu_c_ratio: float
    std_mu_s_ratio: float


class QualityPart(StrEnum):
    """What the quality of a shift's data is made of."""

    FRAMES = "frames"
    PROTECTION = "protection"
    TIME = "time"
    SATURATION = "saturation"
    PLAUSIBILITY = "plausibility"
    CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True, kw_only=True)
class DataQuality:
    """How far the data of a shift can be believed, each 0..1; parts that cannot be judged are left out."""

    score: float
    parts: Mapping[QualityPart, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Revision:
    """What an event made of an earlier one of the same vehicle: now it belongs with the others, or no longer."""

    clutch: int
    end_bus_ns: int  # by these two the earlier event is known
    status: Status
    reasons: tuple[Reason, ...]
    friction: FrictionEstimate | None
    scale_free: ScaleFreeFriction | None
    slope: FrictionSlope | None = None  # as in an estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class EventFit:
    """How well the model explains an event, and what it rests on; all 0 when nothing was estimated."""

    sample_count: int = 0  # torque samples inside the slip window
    window_s: float = 0.0
    chi_square_ratio: float = 0.0  # chi-square per degree of freedom
    quality: float = 0.0  # 0..1: 1 is a full, clean, well-fitting window


@dataclass(frozen=True, slots=True, kw_only=True)
class EventConditions:
    """Under which conditions an event happened; None: its signals do not tell."""

    duration_s: float
    sump_temperature_k: float | None = None
    clutch_temperature_k: float | None = None
    slip_energy_j: float | None = None
    odometer_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftEstimate:
    """What one shift says about the clutch that engaged."""

    number: int
    from_gear: int
    to_gear: int
    clutch: int  # 1 or 2, the on-coming one
    start_ns: int
    end_ns: int
    status: Status
    reasons: tuple[Reason, ...]
    friction: FrictionEstimate | None  # None unless VALID
    conditions: EventConditions
    fit: EventFit = field(default_factory=EventFit)
    data_quality: DataQuality | None = None  # whatever the estimate; None in results of older versions
    scale_free: ScaleFreeFriction | None = None  # None where there is no friction, and in results of older versions
    tier: Tier = Tier.FRICTION  # what the vehicle's signals suffice for
    indices: ShiftIndices | None = None
    kind: EventKind = EventKind.SHIFT  # what happened; the default in results of older versions
    end_reason: EndReason | None = None  # how it ended; None in results of older versions
    slope: FrictionSlope | None = None  # in place of friction where the torque is modelled
    revisions: tuple[Revision, ...] = ()  # of earlier events
    shift_quality: ShiftQuality | None = None  # None in results of older versions, and of what was broken off
    micro_slip: MicroSlip | None = None  # of a lock-up clutch
    element: str | None = None  # name in the description of the transmission; None: clutch 1 or clutch 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LikelyCause:
    """Something that may be wrong, how likely it is, and what speaks for and against it; docs/verdict.md."""

    cause: str  # a word such as glazed-lining, "sound" or "something-else"
    clutch: int | None  # 1 or 2; None: it is of no single clutch
    probability: float  # that it is there, alone or with another
    evidence: str  # one sentence


@dataclass(frozen=True, slots=True, kw_only=True)
class Moved:
    """A quantity that tells causes apart: how it changed, and how it would by the likeliest cause."""

    quantity: str  # in words
    unit: str
    change: float
    std: float
    expected: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Causes:
    """Why a vehicle is as it is, by what changed since the beginning or the last fill: the likeliest first."""

    event_count: int  # events that this rests on, those of the beginning not counted
    likely: tuple[LikelyCause, ...]  # without those that are next to impossible
    advice: str  # what to do, in which order, and what it costs to be wrong
    test: str | None = None  # what would tell the likeliest two from each other; None: driving does
    moved: tuple[Moved, ...] = ()  # what moved most, or should have; none in results of older programs


class Condition(IntEnum):
    """Verdict on one clutch and its fluid, from best to worst; NO_VERDICT is below all."""

    NO_VERDICT = 0
    GOOD = 1
    WATCH = 2
    CHANGE_FLUID = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchVerdict:
    """Condition of one clutch after a shift: what justifies it, and what to do about it."""

    clutch: int
    condition: Condition
    reason: str
    level_ratio: float | None  # mu_c over the calibration's reference
    friction: FrictionEstimate | None  # the running estimate, all shifts combined
    shift_count: int  # shifts in the running estimate
    scale_free: ScaleFreeFriction | None = None  # this and what follows: None while unknown, and in older results
    common_scale_std_ratio: float | None = None  # relative deviation that all friction of the clutch shares
    shift_scatter: ShiftScatter | None = None
    trend: FrictionTrend | None = None  # against the vehicle's own baseline
    clutch_ratio: ClutchRatio | None = None
    lining: LiningChange | None = None  # once there is another fluid than the first
    stick_slip: StickSlip | None = None
    calibration_ratio: float | None = None  # how much of what driving tells of the vehicle is known, 0 to 1
    advice: str | None = None  # what to do, by when, how sure: one sentence for a workshop
    slope: FrictionSlope | None = None  # in place of friction where the torque is modelled
    micro_slip: MicroSlip | None = None  # of a lock-up clutch, all events combined
    element: str | None = None  # as in an estimate
    causes: Causes | None = None  # of what is wrong with the vehicle; the same for both clutches
    running_since_bus_ns: int | None = None  # start of the first event in the running estimate, of an earlier drive


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftResult:
    """What is stored and published for one shift: its own estimate and the clutch's verdict after it."""

    vehicle: str
    stream: str  # UUID of a live stream, sha256 of a log
    seq: int
    estimate: ShiftEstimate
    verdict: ClutchVerdict
    algorithm_version: str
    calibration_version: str
    produced_at: str  # ISO 8601 UTC, from the caller's clock; for a log the end of the shift


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidFill:
    """New fluid in a vehicle: its friction before and after have nothing to do with each other."""

    vehicle: str
    filled_at: str  # ISO 8601 UTC with microseconds and ``Z``, so that texts sort as moments do
    odometer_m: float | None = None
    product: str | None = None  # name of the fluid
    note: str | None = None
    is_withdrawn: bool = False  # it was noted by mistake, and is taken back for good


SHIFT_SCHEMA: Final = Channel.SHIFT.schema_name
_EPOCH: Final = datetime(1970, 1, 1)  # noqa: DTZ001 - UTC, which the text says
_RESULT_KEYS: Final = ("vehicle", "stream", "seq", "produced_at", "algorithm_version", "calibration_version")
_TO_JSON: Final = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
REVISIONS: Final = "revisions"
_ONLY_WHERE_THERE: Final = frozenset(
    {"slope", REVISIONS, "shift_quality", "micro_slip", "element", "causes", "shifting", "running_since_bus_ns"}
)
_NOTHING: Final[tuple[object, ...]] = (None, [])  # of these: a number that is 0 is told
_OF_PACKS: Final = {"slip_energy_j": "slip_energy{}_j", "peak_k": "peak{}_k", "life_ratio": "life{}_ratio"}
_PUBLIC_NAMES: Final = {"start_ns": "start_bus_ns", "end_ns": "end_bus_ns", "data_quality": "trust"}
RECENT_COUNT: Final = 8  # results of a run that are kept to be shown


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftStatistics:
    """Counts of the shifts of one run, and its last results; replaced, never changed: other threads read them."""

    by_status: Mapping[str, int] = field(default_factory=lambda: {status.value: 0 for status in Status})
    by_reason: Mapping[str, int] = field(default_factory=dict)  # sorted
    by_clutch: Mapping[tuple[int, str], int] = field(default_factory=dict)  # clutch, status -> shifts
    stored_count: int = 0
    known_count: int = 0  # their key was in the store before
    latest: Mapping[int, ShiftResult] = field(default_factory=dict)  # of each clutch
    recent: tuple[ShiftResult, ...] = ()  # oldest first

    def with_shift(self, result: ShiftResult, *, is_new: bool) -> Self:
        estimate, status = result.estimate, result.estimate.status.value
        by_reason = self.by_reason
        if estimate.reasons:
            added = Counter(reason.value for reason in estimate.reasons)
            by_reason = dict(sorted((added + Counter(by_reason)).items()))
        key = estimate.clutch, status
        return replace(
            self,
            by_status={**self.by_status, status: self.by_status[status] + 1},
            by_reason=by_reason,
            by_clutch={**self.by_clutch, key: self.by_clutch.get(key, 0) + 1},
            stored_count=self.stored_count + is_new,
            known_count=self.known_count + (not is_new),
            latest={**self.latest, estimate.clutch: result},
            recent=(*self.recent, result)[-RECENT_COUNT:],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceStatus:
    """Whether a live service watches a vehicle; retained on the broker, and its last will."""

    vehicle: str
    is_online: bool
    connected_at: str  # ISO 8601 UTC, start of the broker connection that carries this status
    service_version: str
    algorithm_version: str
    calibration_version: str
    calibration: JsonObject | None = None  # its type, and the friction of its clutches with new fluid


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredResult:
    """A row of the outbox: its position in the store, and the record of the result as it is stored."""

    position: int
    key: ResultKey
    clutch: int
    produced_at: str
    text: str  # the JSON of the record


def utc_from_bus_ns(t_ns: int) -> str:
    """Return a bus time as ISO 8601 UTC with microseconds."""
    return (_EPOCH + timedelta(microseconds=t_ns // 1000)).isoformat(timespec="microseconds") + "Z"


def iso_utc(moment: datetime) -> str:
    """Return an aware moment as ISO 8601 UTC with microseconds and a final ``Z``."""
    return moment.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"


def shift_record(result: ShiftResult) -> JsonObject:
    """Return the public form of one shift result, keys in their published order; what is grouped here is flat there."""
    estimate, quality = to_plain(result.estimate), result.estimate.shift_quality
    estimate |= to_plain(result.estimate.conditions) | to_plain(result.estimate.fit)
    estimate["shift_quality"] = None if quality is None else quality_record(quality)
    record = estimate | {public: estimate[name] for name, public in _PUBLIC_NAMES.items()}
    record |= {key: getattr(result, key) for key in _RESULT_KEYS}
    verdict = to_plain(result.verdict) | {"condition": result.verdict.condition.name.lower()}
    verdict = {key: value for key, value in verdict.items() if key not in _ONLY_WHERE_THERE or value not in _NOTHING}
    record |= {"schema": SHIFT_SCHEMA, "verdict": verdict}
    start_ns, end_ns = result.estimate.start_ns, result.estimate.end_ns
    record |= {"start_utc": utc_from_bus_ns(start_ns), "end_utc": utc_from_bus_ns(end_ns)}
    record = {key: record[key] for key in _keys_of(Channel.SHIFT)}
    return {key: value for key, value in record.items() if key not in _ONLY_WHERE_THERE or value not in _NOTHING}


def quality_record(quality: ShiftQuality) -> JsonObject:
    """Return how well an event went as messages have it."""
    record = {**to_plain(quality), **to_plain(quality.parts), **to_plain(quality.control)}
    for clutch, pack in enumerate(quality.packs, 1):
        plain = to_plain(pack)
        record |= {public.format(clutch): plain[name] for name, public in _OF_PACKS.items()}
    return {key: record[key] for key in quality_keys()}


def quality_from(table: object) -> ShiftQuality:
    """Read back a ``quality_record``; what it lacks its signals did not tell; raises ValueError."""
    return from_plain(_with_groups(table), ShiftQuality)


def _with_groups(table: object) -> object:
    """Return a ``quality_record`` with its groups."""
    if not isinstance(table, dict):
        return table
    packs = [{name: table.get(key.format(clutch)) for name, key in _OF_PACKS.items()} for clutch in (1, 2)]
    return table | {"parts": table, "control": table, "packs": packs}


def clutch_record(shift: JsonObject, order: Order | None = None, shifting: str | None = None) -> JsonObject:
    """Return the state of the clutch after the shift that last engaged it, from the ``shift_record`` of that shift.

    The order is that for the vehicle, the same in the states of both clutches; records of older programs lack some.
    So is ``shifting``, what is told where friction is not.
    """
    if not isinstance(verdict := shift["verdict"], dict):
        raise ResultError(f"incomplete {SHIFT_SCHEMA} record: no verdict")
    record = {**verdict, **{key: shift[key] for key in (*_RESULT_KEYS, "end_utc")}}
    record |= {"schema": Channel.CLUTCH.schema_name, "shifting": shifting, **order_record(order)}
    record = {key: record.get(key) for key in _keys_of(Channel.CLUTCH)}
    return {key: value for key, value in record.items() if key not in _ONLY_WHERE_THERE or value not in _NOTHING}


def order_record(order: Order | None) -> JsonObject:
    """Return the order for a vehicle as records hold it."""
    return {"action": None, "order": None} if order is None else {"action": order.action.value, "order": order.text}


def status_record(status: ServiceStatus) -> JsonObject:
    """Return the public form of the service's status."""
    word = "online" if status.is_online else "offline"
    record = {**to_plain(status), "schema": Channel.STATUS.schema_name, "status": word}
    return {key: record[key] for key in _keys_of(Channel.STATUS) if record[key] is not None}


def dump(record: Mapping[str, object]) -> str:
    """Return a record as one line of JSON, floats to every bit; raises ResultError if one is NaN or infinite."""
    try:
        text = _TO_JSON.encode(record)
        return text if "\\ud" not in text else _TO_JSON.encode(legible_record(record))
    except ValueError as exc:
        raise ResultError(f"a result holds a number that is not finite: {record!r}") from exc


def parse_shift(text: str) -> ShiftResult:
    """Read back what ``dump(shift_record(...))`` wrote; raises ResultError if it is none of this version."""
    try:
        record = json.loads(text)
    except ValueError as exc:
        raise ResultError(f"not a shift result: {exc}") from exc
    if not isinstance(record, dict) or record.get("schema") != SHIFT_SCHEMA:
        raise ResultError(f"not a {SHIFT_SCHEMA} record")
    return shift_from(record)


def shift_from(record: JsonObject) -> ShiftResult:
    """Read back a ``shift_record``, whose schema the caller knows; unknown keys are ignored; raises ResultError."""
    try:
        estimate = record | {name: record.get(public) for name, public in _PUBLIC_NAMES.items()}
        estimate |= {"conditions": record, "fit": record, "shift_quality": _with_groups(record.get("shift_quality"))}
        verdict = _condition_as_number(record.get("verdict"))
        return from_plain(record | {"estimate": estimate, "verdict": verdict}, ShiftResult)
    except ValueError as exc:
        raise ResultError(f"incomplete {SHIFT_SCHEMA} record: {exc}") from exc


def verdict_from(table: object) -> ClutchVerdict:
    """Read back the verdict in a ``clutch_record``; raises ResultError if it is none of this version."""
    try:
        return from_plain(_condition_as_number(table), ClutchVerdict)
    except ValueError as exc:
        raise ResultError(f"incomplete {Channel.CLUTCH.schema_name} record: {exc}") from exc


def fill_words(fill: FluidFill) -> str:
    """Return the moment of a fill for people."""
    return f"{fill.filled_at[:16].replace('T', ' ')} UTC"


def fill_record(fill: FluidFill) -> JsonObject:
    """Return a fluid fill as it stands in a message; of which vehicle the message says."""
    left_out = {"vehicle"} if fill.is_withdrawn else {"vehicle", "is_withdrawn"}
    return {key: value for key, value in to_plain(fill).items() if key not in left_out}


def fills_from(table: Mapping[str, object]) -> list[FluidFill]:
    """Return the fluid fills in a message, withdrawn ones too; raises ResultError if they are none of this version."""
    fills, withdrawn = table.get("fills"), table.get("withdrawn", [])
    if not isinstance(fills, list) or not isinstance(withdrawn, list):
        raise ResultError("fluid fills are a list")
    fills = [*fills, *({"filled_at": moment, "is_withdrawn": True} for moment in withdrawn)]
    try:
        return [from_plain({**fill, "vehicle": table.get("vehicle")}, FluidFill) for fill in fills]
    except (TypeError, ValueError) as exc:
        raise ResultError(f"incomplete fluid fills: {exc}") from exc


def _condition_as_number(table: object) -> object:
    """Return the table of a verdict with the number of its condition in place of the public word."""
    if not isinstance(table, dict):
        return table
    return table | {"condition": Condition.__members__.get(str(table.get("condition")).upper())}


@cache
def _keys_of(channel: Channel) -> tuple[str, ...]:
    """Return the keys of a channel's records in the order in which its schema describes them."""
    document: Any = schema(channel.label)
    return tuple(document["properties"])


@cache
def quality_keys() -> tuple[str, ...]:
    """Return the keys of a ``quality_record`` in the order in which the schema describes them."""
    document: Any = schema(Channel.SHIFT.label)
    return tuple(document["$defs"]["shift_quality"]["properties"])
