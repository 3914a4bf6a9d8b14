"""The public, versioned JSON of the service: shift results, clutch states, service status.

Within a version keys are only ever added; a reader ignores those it does not know. ``fleet_contract`` holds the JSON
Schemas (2020-12) and the envelope in which records travel. Keys keep one order, so equal results are equal texts.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

from diag_service.diagnosis.comparison import ClutchRatio, FrictionTrend, ScaleFreeFriction, ShiftScatter
from diag_service.diagnosis.records import (
    ClutchVerdict,
    Condition,
    DataQuality,
    FrictionEstimate,
    QualityPart,
    Reason,
    ShiftEstimate,
    ShiftIndices,
    ShiftResult,
    Status,
    Tier,
)
from diag_service.errors import ResultError
from fleet_contract import Channel, ResultKey
from program_io.legible import legible_record

JsonObject = dict[str, object]

SHIFT_SCHEMA = Channel.SHIFT.schema_name

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NS_PER_US = 1000
_INDEX_KEYS = tuple(field.name for field in fields(ShiftIndices))
_Numbers = FrictionEstimate | ScaleFreeFriction | ShiftScatter | FrictionTrend | ClutchRatio
ValueT = TypeVar("ValueT", bool, int, float, str)
NumbersT = TypeVar("NumbersT", bound=_Numbers)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceStatus:
    """Whether a live service watches a vehicle; retained on the broker, and its last will."""

    vehicle: str
    is_online: bool
    connected_at: str  # ISO 8601 UTC, start of the broker connection that carries this status
    service_version: str
    algorithm_version: str
    calibration_version: str


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
    return iso_utc(_EPOCH + timedelta(microseconds=t_ns // _NS_PER_US))


def iso_utc(moment: datetime) -> str:
    """Return an aware moment as ISO 8601 UTC with microseconds and a final ``Z``."""
    return moment.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"


def shift_record(result: ShiftResult) -> JsonObject:
    """Return the public form of one shift result, keys in their published order."""
    estimate = result.estimate
    return {
        "schema": SHIFT_SCHEMA,
        "vehicle": result.vehicle,
        "stream": result.stream,
        "seq": result.seq,
        "number": estimate.number,
        "produced_at": result.produced_at,
        "start_utc": utc_from_bus_ns(estimate.start_ns),
        "end_utc": utc_from_bus_ns(estimate.end_ns),
        "start_bus_ns": estimate.start_ns,
        "end_bus_ns": estimate.end_ns,
        "duration_s": estimate.duration_s,
        "from_gear": estimate.from_gear,
        "to_gear": estimate.to_gear,
        "clutch": estimate.clutch,
        "status": estimate.status.value,
        "reasons": [reason.value for reason in estimate.reasons],
        "friction": _numbers_record(estimate.friction),
        "scale_free": _numbers_record(estimate.scale_free),
        "sample_count": estimate.sample_count,
        "window_s": estimate.window_s,
        "chi_square_ratio": estimate.chi_square_ratio,
        "quality": estimate.quality,
        "sump_temperature_k": estimate.sump_temperature_k,
        "clutch_temperature_k": estimate.clutch_temperature_k,
        "slip_energy_j": estimate.slip_energy_j,
        "odometer_m": estimate.odometer_m,
        "trust": _data_quality_record(estimate.data_quality),
        "verdict": _verdict_record(result.verdict),
        "algorithm_version": result.algorithm_version,
        "calibration_version": result.calibration_version,
        "tier": int(estimate.tier),
        "indices": None if estimate.indices is None else asdict(estimate.indices),
    }


def clutch_record(result: ShiftResult) -> JsonObject:
    """Return the state of the clutch after the shift that last engaged it."""
    return {
        "schema": Channel.CLUTCH.schema_name,
        "vehicle": result.vehicle,
        **_verdict_record(result.verdict),
        "stream": result.stream,
        "seq": result.seq,
        "produced_at": result.produced_at,
        "end_utc": utc_from_bus_ns(result.estimate.end_ns),
        "algorithm_version": result.algorithm_version,
        "calibration_version": result.calibration_version,
    }


def status_record(status: ServiceStatus) -> JsonObject:
    """Return the public form of the service's status."""
    return {
        "schema": Channel.STATUS.schema_name,
        "vehicle": status.vehicle,
        "status": "online" if status.is_online else "offline",
        "connected_at": status.connected_at,
        "service_version": status.service_version,
        "algorithm_version": status.algorithm_version,
        "calibration_version": status.calibration_version,
    }


def dump(record: Mapping[str, object]) -> str:
    """Return a record as one line of JSON; floats keep every bit.

    Raises
    ------
    ResultError
        If a number is NaN or infinite, which JSON cannot carry.
    """
    try:
        text = json.dumps(record, allow_nan=False, separators=(",", ":"))
        if "\\ud" not in text:
            return text
        return json.dumps(legible_record(record), allow_nan=False, separators=(",", ":"))
    except ValueError as exc:
        raise ResultError(f"a result holds a number that is not finite: {record!r}") from exc


def parse_shift(text: str) -> ShiftResult:
    """Read back what ``dump(shift_record(...))`` wrote; unknown keys are ignored.

    Raises
    ------
    ResultError
        If the text is not a shift result of this version.
    """
    try:
        table = json.loads(text)
    except ValueError as exc:
        raise ResultError(f"not a shift result: {exc}") from exc
    return shift_from(table)


def shift_from(table: object) -> ShiftResult:
    """Read back a ``shift_record``; raises ResultError if it is none of this version."""
    if not isinstance(table, dict) or table.get("schema") != SHIFT_SCHEMA:
        raise ResultError(f"not a {SHIFT_SCHEMA} record")
    try:
        return _shift_from(table)
    except (KeyError, TypeError, ValueError) as exc:
        raise ResultError(f"incomplete {SHIFT_SCHEMA} record: {exc!r}") from exc


def verdict_from(table: object) -> ClutchVerdict:
    """Read back the verdict in a ``clutch_record``; raises ResultError if it is none of this version."""
    try:
        return _verdict_from(table)
    except (KeyError, TypeError, ValueError) as exc:
        raise ResultError(f"incomplete {Channel.CLUTCH.schema_name} record: {exc!r}") from exc


def _numbers_record(numbers: _Numbers | None) -> JsonObject | None:
    return None if numbers is None else asdict(numbers)


def _data_quality_record(quality: DataQuality | None) -> JsonObject | None:
    if quality is None:
        return None
    return {"score": quality.score, "parts": {part.value: value for part, value in quality.parts.items()}}


def _verdict_record(verdict: ClutchVerdict) -> JsonObject:
    return {
        "clutch": verdict.clutch,
        "condition": verdict.condition.name.lower(),
        "reason": verdict.reason,
        "level_ratio": verdict.level_ratio,
        "friction": _numbers_record(verdict.friction),
        "shift_count": verdict.shift_count,
        "scale_free": _numbers_record(verdict.scale_free),
        "common_scale_std_ratio": verdict.common_scale_std_ratio,
        "shift_scatter": _numbers_record(verdict.shift_scatter),
        "trend": _numbers_record(verdict.trend),
        "clutch_ratio": _numbers_record(verdict.clutch_ratio),
    }


def _shift_from(table: JsonObject) -> ShiftResult:
    reasons = table["reasons"]
    if not isinstance(reasons, list):
        raise TypeError("reasons must be a list")
    estimate = ShiftEstimate(
        number=_value(table, "number", int),
        from_gear=_value(table, "from_gear", int),
        to_gear=_value(table, "to_gear", int),
        clutch=_value(table, "clutch", int),
        start_ns=_value(table, "start_bus_ns", int),
        end_ns=_value(table, "end_bus_ns", int),
        status=Status(_value(table, "status", str)),
        reasons=tuple(Reason(reason) for reason in reasons),
        friction=_numbers_from(FrictionEstimate, table["friction"]),
        sample_count=_value(table, "sample_count", int),
        window_s=_value(table, "window_s", float),
        chi_square_ratio=_value(table, "chi_square_ratio", float),
        quality=_value(table, "quality", float),
        sump_temperature_k=_optional(table, "sump_temperature_k"),
        clutch_temperature_k=_optional(table, "clutch_temperature_k"),
        slip_energy_j=_optional(table, "slip_energy_j"),
        duration_s=_value(table, "duration_s", float),
        odometer_m=_optional(table, "odometer_m"),
        tier=Tier(_value(table, "tier", int)) if "tier" in table else Tier.FRICTION,  # older results lack both
        indices=_indices_from(table.get("indices")),
        data_quality=_data_quality_from(table.get("trust")),
        scale_free=_numbers_from(ScaleFreeFriction, table.get("scale_free")),
    )
    return ShiftResult(
        vehicle=_value(table, "vehicle", str),
        stream=_value(table, "stream", str),
        seq=_value(table, "seq", int),
        estimate=estimate,
        verdict=_verdict_from(table["verdict"]),
        algorithm_version=_value(table, "algorithm_version", str),
        calibration_version=_value(table, "calibration_version", str),
        produced_at=_value(table, "produced_at", str),
    )


def _verdict_from(table: object) -> ClutchVerdict:
    if not isinstance(table, dict):
        raise TypeError("verdict must be an object")
    return ClutchVerdict(
        clutch=_value(table, "clutch", int),
        condition=Condition[_value(table, "condition", str).upper()],
        reason=_value(table, "reason", str),
        level_ratio=_optional(table, "level_ratio"),
        friction=_numbers_from(FrictionEstimate, table["friction"]),
        shift_count=_value(table, "shift_count", int),
        scale_free=_numbers_from(ScaleFreeFriction, table.get("scale_free")),
        common_scale_std_ratio=_optional({"common_scale_std_ratio": None, **table}, "common_scale_std_ratio"),
        shift_scatter=_numbers_from(ShiftScatter, table.get("shift_scatter")),
        trend=_numbers_from(FrictionTrend, table.get("trend")),
        clutch_ratio=_numbers_from(ClutchRatio, table.get("clutch_ratio")),
    )


def _data_quality_from(table: object) -> DataQuality | None:
    if table is None:
        return None
    if not isinstance(table, dict) or not isinstance(table["parts"], dict):
        raise TypeError("trust must be an object with parts, or null")
    parts = {QualityPart(name): _value(table["parts"], name, float) for name in table["parts"]}
    return DataQuality(score=_value(table, "score", float), parts=parts)


def _numbers_from(kind: type[NumbersT], table: object) -> NumbersT | None:
    """Read back a record that holds only floats and integers."""
    if table is None:
        return None
    if not isinstance(table, dict):
        raise TypeError(f"{kind.__name__} must be an object or null")
    numbers: dict[str, Any] = {
        one.name: _value(table, one.name, int) if one.type is int else _value(table, one.name, float)
        for one in fields(kind)
    }
    return kind(**numbers)


def _indices_from(table: object) -> ShiftIndices | None:
    if table is None:
        return None
    if not isinstance(table, dict):
        raise TypeError("indices must be an object or null")
    return ShiftIndices(**{key: _optional(table, key) for key in _INDEX_KEYS})


def _value(table: Mapping[str, object], key: str, kind: type[ValueT]) -> ValueT:
    value = table[key]
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return kind(value)
    if not isinstance(value, kind) or isinstance(value, bool) is not (kind is bool):
        raise TypeError(f"{key} must be {kind.__name__}, got {value!r}")
    return value


def _optional(table: Mapping[str, object], key: str) -> float | None:
    return None if table[key] is None else _value(table, key, float)
