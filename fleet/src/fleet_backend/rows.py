"""Checked messages become rows of the database."""

import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import lru_cache
from hashlib import blake2b, sha256
from operator import itemgetter
from typing import Any, Final

import msgspec

from fleet_backend.schema import FRICTION_COLUMNS, FRICTION_TIER, RUNNING, SCALE_FREE, SCALE_FREE_COLUMNS

_NUMBER: Final = re.compile(r"[0-9]+")
_BETWEEN: Final = "\x1f"  # the unit separator, below every printable character


@lru_cache(maxsize=1024)
def version_rank(algorithm_version: str, calibration_version: str) -> str:
    """Return a text that is greater, byte by byte, for a newer algorithm or else a newer calibration.

    Numbers inside a version count as numbers, so ``-10`` is newer than ``-9``. The rank depends on the versions alone,
    not on when a result arrived, and different versions have different ranks.
    """
    versions = (algorithm_version, calibration_version)
    # The length of each number stands before it.
    return _BETWEEN.join(_NUMBER.sub(lambda match: f"{len(match[0]):03}{match[0]}", version) for version in versions)


Row = dict[str, object]
Data = Mapping[str, Any]  # of a message that kept the contract

_PLAIN: Final = (
    "vehicle",
    "stream",
    "seq",
    "algorithm_version",
    "calibration_version",
    "clutch",
    "number",
    "start_bus_ns",
    "end_bus_ns",
    "duration_s",
    "from_gear",
    "to_gear",
    "status",
    "sample_count",
    "window_s",
    "chi_square_ratio",
    "quality",
    "sump_temperature_k",
    "clutch_temperature_k",
    "slip_energy_j",
    "odometer_m",
)
_PLAIN_OF: Final = itemgetter(*_PLAIN)  # a tuple, as are those below
_FRICTION_OF: Final = itemgetter(*FRICTION_COLUMNS)
_RUNNING_FRICTION: Final = tuple(RUNNING + name for name in FRICTION_COLUMNS)
CONTENT: Final = (
    *_PLAIN,
    *("version_rank", "produced_at", "start_at", "end_at", "reasons"),
    *FRICTION_COLUMNS,
    *("condition", "condition_reason", "level_ratio"),
    *_RUNNING_FRICTION,
    "running_shift_count",
)
_CONTENT_OF: Final = itemgetter(*CONTENT)
_SORTED: Final = json.JSONEncoder(sort_keys=True)
_JSON: Final = msgspec.json.Encoder()
UNNAMED_FLUID: Final = "not named"  # a fill without the name of its fluid
_SHOWN_CAUSES: Final = 3
_HEAD_LENGTH: Final = 2048
_DETAIL_LENGTH: Final = 500
_LONGEST_TEXT: Final = 200  # of a fill in a message


def shift_row(data: Data) -> Row:
    """Return the row of a shift result."""
    row: Row = dict(zip(_PLAIN, _PLAIN_OF(data), strict=True))
    verdict = data["verdict"]
    row["version_rank"] = version_rank(data["algorithm_version"], data["calibration_version"])
    row["produced_at"] = moment(data["produced_at"])
    row["start_at"] = moment(data["start_utc"])
    row["end_at"] = moment(data["end_utc"])
    row["reasons"] = ",".join(data["reasons"])
    row.update(_friction(data["friction"], FRICTION_COLUMNS))
    row["condition"] = verdict["condition"]
    row["condition_reason"] = verdict["reason"]
    row["level_ratio"] = verdict["level_ratio"]
    row.update(_friction(verdict["friction"], _RUNNING_FRICTION))
    row["running_shift_count"] = verdict["shift_count"]
    row["kind"], row["end_reason"] = data.get("kind"), data.get("end_reason")  # this and the next: of newer programs
    row["advice"] = verdict.get("advice")
    row.update(_scale_free(data.get("scale_free")))
    row.update(_trust(data.get("trust")))
    quality = data.get("shift_quality")
    row["shift_quality"] = None if quality is None else _JSON.encode(quality).decode()
    row["element"] = data.get("element")
    row["running_since_bus_ns"] = verdict.get("running_since_bus_ns")
    causes = verdict.get("causes")
    row["causes"] = None if causes is None else _JSON.encode(_foremost(causes)).decode()
    row["tier"], row["indices"] = data.get("tier"), _indices(data)
    row["content_digest"] = content_digest(row)
    return row


def _indices(data: Data) -> str | None:
    """Return the numbers that speeds and torques tell of an event; None where its signals tell friction."""
    indices = data.get("indices")
    if indices is None or data.get("tier", FRICTION_TIER) == FRICTION_TIER:
        return None
    return _JSON.encode({name: value for name, value in indices.items() if isinstance(value, int | float)}).decode()


def _foremost(causes: Data) -> Row:
    """Return the likeliest causes, with the evidence of the first alone: each result carries them."""
    first, *others = causes["likely"][:_SHOWN_CAUSES] or [None]
    return {**causes, "likely": [] if first is None else [first, *({**cause, "evidence": ""} for cause in others)]}


def content_digest(row: Row) -> int:
    """Return a number that two contents of one result share only if they are equal.

    Databases hold it and compare it with that of a result that comes again, so a result must keep its own: it is made
    of these columns in this order, of nothing that a row gets besides.
    """
    content = repr(_CONTENT_OF(row)).encode("utf-8", "replace")
    return int.from_bytes(blake2b(content, digest_size=8).digest(), signed=True)


def status_row(data: Data) -> Row:
    """Return what the status of a service says about its vehicle."""
    names = ("vehicle", "service_version", "algorithm_version", "calibration_version")
    state = {"is_online": data["status"] == "online", "connected_at": moment(data["connected_at"])}
    return {**{name: data[name] for name in names}, **state}


def calibration_rows(data: Data) -> list[Row]:
    """Return the row of what the status of a service says of its calibration; none by older programs."""
    if (calibration := data.get("calibration")) is None:
        return []
    names = ("vehicle", "calibration_version")
    return [{**{name: data[name] for name in names}, "content": json.dumps(calibration)}]


def revision_rows(data: Data) -> list[Row]:
    """Return the rows of what a result made of earlier ones of its vehicle."""
    rows: list[Row] = []
    for revision in data.get("revisions", ()):
        now = {"status": revision["status"], "reasons": ",".join(revision["reasons"])}
        now |= _friction(revision["friction"], FRICTION_COLUMNS) | _scale_free(revision["scale_free"])
        key = {name: data[name] for name in ("vehicle", "stream", "seq")}
        key |= {name: revision[name] for name in ("clutch", "end_bus_ns")}
        rows.append({**key, "content": json.dumps(now)})
    return rows


def fill_rows(data: Data) -> list[Row]:
    """Return the rows of the fluid fills that a vehicle knows; of those that are taken back the key alone."""
    withdrawn = data.get("withdrawn", ())
    return [{"vehicle": data["vehicle"], "filled_at": moment(filled_at)} for filled_at in withdrawn] + [
        {
            "vehicle": data["vehicle"],
            "filled_at": moment(fill["filled_at"]),
            "odometer_m": fill["odometer_m"],
            "product": fill["product"] or UNNAMED_FLUID,
            "note": fill["note"],
        }
        for fill in data["fills"]
    ]


def message_fill(row: Data) -> Row:
    """Return a fluid fill, or the key of a withdrawn one, as a message carries it; a long text loses its end."""
    key = {"filled_at": row["filled_at"].astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")}
    if "product" not in row:
        return key | {"is_withdrawn": True}
    product, note = row["product"], row["note"]
    return key | {
        "odometer_m": row["odometer_m"],
        "product": None if product == UNNAMED_FLUID else product[:_LONGEST_TEXT] or None,
        "note": note[:_LONGEST_TEXT] if note else None,
    }


def metrics_row(data: Data) -> Row:
    """Return the last numbers of a service."""
    metrics = json.dumps(data["metrics"], sort_keys=True)
    return {"vehicle": data["vehicle"], "metrics": metrics, "metrics_at": moment(data["produced_at"])}


def controller_row(data: Data) -> Row:
    """Return the row of what a controller said of its trouble codes."""
    report = json.dumps({key: data[key] for key in ("controller", "description", "codes")}, sort_keys=True)
    return {"vehicle": data["vehicle"], "controller": report, "controller_at": moment(data["produced_at"])}


def quarantine_row(
    received_at: datetime,
    topic: str,
    vehicle: str | None,
    payload: bytes,
    *,
    reason: str,
    detail: str,
    unread_bytes: int = 0,
) -> Row:
    """Return the row that keeps a poison message aside: enough to find its cause, never all of a large one."""
    return {
        "digest": sha256(topic.encode("utf-8", "replace") + b"\0" + payload).hexdigest(),
        "topic": _shown(topic)[:_DETAIL_LENGTH],
        "vehicle": vehicle,
        "reason": reason,
        "detail": _shown(detail)[:_DETAIL_LENGTH],
        "size_bytes": len(topic.encode("utf-8", "replace")) + unread_bytes + len(payload),
        "head": _shown(payload[:_HEAD_LENGTH].decode("utf-8", "backslashreplace")),
        "received_at": received_at,
    }


def moment(text: str) -> datetime:
    """Return an aware moment from ISO 8601 UTC."""
    return datetime.fromisoformat(text).astimezone(UTC)


def _friction(friction: Data | None, names: tuple[str, ...]) -> Row:
    return dict.fromkeys(names) if friction is None else dict(zip(names, _FRICTION_OF(friction), strict=True))


def _scale_free(friction: Data | None) -> Row:
    """Return what driving alone tells of the friction; nothing in results of older programs."""
    return {SCALE_FREE + name: (friction or {}).get(name) for name in SCALE_FREE_COLUMNS}


def _trust(trust: Data | None) -> Row:
    if trust is None:
        return {"trust": None, "trust_parts": None}
    return {"trust": trust["score"], "trust_parts": _SORTED.encode(trust["parts"])}


def _shown(text: str) -> str:
    """Return a text that every database takes and every terminal survives."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)
