"""The table of a controller's diagnosis from a TOML file; each key is checked, the first wrong one is named."""

import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from enum import StrEnum
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, TypeVar, get_args, get_origin, get_type_hints

from canlog.files import read_small_file
from clutch_model.calibration import CONVERTERS
from ecu_emulator.diagnostics.descriptions import (
    IN_USE,
    Access,
    Condition,
    Datum,
    ExtendedRecord,
    MonitorTest,
    Obd,
    Pid,
    Profile,
    Routine,
    SecurityLevel,
    ServiceAccess,
    Session,
    Trouble,
    VehicleInfo,
)
from ecu_emulator.diagnostics.table import (
    Addressing,
    ClutchLimits,
    DiagnosticTable,
    DoipEntity,
    Limits,
    Periodic,
    Timing,
    Transport,
)
from ecu_emulator.errors import ConfigError

RecordT = TypeVar("RecordT")
KeyT = TypeVar("KeyT", int, str)

_LISTS: Final = (
    "session",
    "security",
    "service",
    "condition",
    "data",
    "routine",
    "trouble",
    "extended",
    "pid",
    "vehicle_info",
    "monitor",
)
_LIKE: Final = "like_"
_OPTIONAL: Final = ("clutches", "doip", "obd", "obd_clear_conditions", "periodic")
_TABLES: Final = ("name", "snapshot", "addressing", "transport", "timing", "limits", "access")


@cache
def shipped_table() -> DiagnosticTable:
    """Return the table of the emulated transmission controller."""
    text = files("ecu_emulator").joinpath("diagnostics/tcu.toml").read_text(encoding="utf-8")
    return parse_table(text, "tcu.toml")


@cache
def table_of(transmission: str) -> DiagnosticTable:
    """Return the table of the controller of a transmission: one of a converter has data and codes of its own."""
    shipped = shipped_table()
    if transmission not in CONVERTERS:
        return shipped
    document = tomllib.loads(files("ecu_emulator").joinpath("diagnostics/converter.toml").read_text(encoding="utf-8"))
    access = {"open": Access(sessions=tuple(shipped.sessions))}
    own = _numbered(_records(Trouble, document, "trouble", {}), "trouble")
    return replace(
        shipped,
        name=document["name"],
        data={**shipped.data, **_numbered(_records(Datum, document, "data", access), "data")},
        troubles={**shipped.troubles, **own},
    )


def personalities() -> tuple[str, ...]:
    """Return the names of controllers of real cars that the emulated one can answer like."""
    found = (one.name for one in files("ecu_emulator").joinpath("diagnostics").iterdir())
    return tuple(sorted(name[len(_LIKE) : -len(".toml")] for name in found if name.startswith(_LIKE)))


@cache
def table_like(name: str, transmission: str = "nominal") -> DiagnosticTable:
    """Return the table of a transmission with the data that another controller has besides, and its times to answer.

    Raises ConfigError if there is no such personality.
    """
    if name not in personalities():
        raise ConfigError(f"nobody answers like {name}: there are {', '.join(personalities())}")
    file = files("ecu_emulator").joinpath(f"diagnostics/{_LIKE}{name}.toml")
    document, own = tomllib.loads(file.read_text(encoding="utf-8")), table_of(transmission)
    access = {"open": Access(sessions=tuple(own.sessions))}
    data = _numbered(_records(Datum, document, "data", access), "data")
    return replace(
        own,
        name=document["name"],
        timing=replace(own.timing, **document["timing"]),
        limits=replace(own.limits, **document["limits"]),
        data={**own.data, **data},
    )


def load_table(path: Path) -> DiagnosticTable:
    """Return the table in a TOML file.

    Raises
    ------
    ConfigError
        Naming the file and the first key that cannot be used.
    """
    try:
        return parse_table(read_small_file(path).decode("utf-8"), str(path))
    except OSError as exc:
        raise ConfigError(f"cannot read {path}: {exc.strerror or exc}") from exc
    except UnicodeDecodeError as exc:
        raise ConfigError(f"{path} is not UTF-8") from exc


def parse_table(text: str, where: str) -> DiagnosticTable:
    """Return the table that a TOML text holds.

    Raises
    ------
    ConfigError
        Beginning with ``where`` and naming the first key that cannot be used.
    """
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as exc:
        raise ConfigError(f"{where} is not TOML: {exc}") from exc
    try:
        return _table(document)
    except ConfigError as exc:
        raise ConfigError(f"{where}: {exc}") from exc


def _table(document: Mapping[str, Any]) -> DiagnosticTable:
    _check_keys(document, {*_LISTS, *_OPTIONAL, *_TABLES}, set(_TABLES), "the table")
    access = {
        name: _record(Access, entry, f"access.{name}", {})
        for name, entry in _mapping(document["access"], "access").items()
    }
    data = _numbered(_records(Datum, document, "data", access), "data")
    routines = _numbered(_records(Routine, document, "routine", access), "routine")
    name, obd = _value(str, document["name"], "name", {}), _obd(document)
    extended = _numbered(_records(ExtendedRecord, document, "extended", {}), "extended")
    if obd is not None and obd.profile is Profile.UDS:
        extended.setdefault(IN_USE.number, IN_USE)
    return DiagnosticTable(
        name=str(name),
        addressing=_record(Addressing, document["addressing"], "addressing", {}),
        transport=_record(Transport, document["transport"], "transport", {}),
        timing=_record(Timing, document["timing"], "timing", {}),
        limits=_record(Limits, document["limits"], "limits", {}),
        sessions=_numbered(_records(Session, document, "session", {}), "session"),
        levels=_numbered(_records(SecurityLevel, document, "security", {}), "security"),
        services=_numbered(_records(ServiceAccess, document, "service", {}), "service"),
        conditions=_unique(
            [(entry.name, entry) for entry in _records(Condition, document, "condition", {})], "condition"
        ),
        data=data,
        routines=routines,
        troubles=_numbered(_records(Trouble, document, "trouble", {}), "trouble"),
        extended=extended,
        snapshot=_value(tuple[int, ...], document["snapshot"], "snapshot", {}),
        obd=obd,
        doip=_record(DoipEntity, document.get("doip", {}), "doip", {}),
        periodic=_record(Periodic, document["periodic"], "periodic", {}) if "periodic" in document else None,
        clutches=_record(ClutchLimits, document.get("clutches", {}), "clutches", {}),
    )


def _obd(document: Mapping[str, Any]) -> Obd | None:
    if "obd" not in document:
        if unused := sorted({"pid", "vehicle_info", "monitor", "obd_clear_conditions"} & set(document)):
            raise ConfigError(f"{unused[0]} is there, but key obd is missing: it says how OBD is spoken")
        return None
    conditions = document.get("obd_clear_conditions", [])
    return Obd(
        profile=_value(Profile, document["obd"], "obd", {}),
        clear_conditions=_value(tuple[str, ...], conditions, "obd_clear_conditions", {}),
        pids=_numbered(_records(Pid, document, "pid", {}), "pid"),
        infos=_numbered(_records(VehicleInfo, document, "vehicle_info", {}), "vehicle_info"),
        monitors=_numbered(_records(MonitorTest, document, "monitor", {}), "monitor"),
    )


def _records(
    record: type[RecordT], document: Mapping[str, Any], key: str, access: Mapping[str, Access]
) -> tuple[RecordT, ...]:
    entries = document.get(key, [])
    if not isinstance(entries, list):
        raise ConfigError(f"{key} must be an array of tables")
    return tuple(_record(record, entry, f"{key} {place}", access) for place, entry in enumerate(entries, start=1))


def _numbered(records: tuple[RecordT, ...], where: str) -> dict[int, RecordT]:
    return _unique([(record.number, record) for record in records], where)  # type: ignore[attr-defined]  # every caller's has it


def _unique(pairs: list[tuple[KeyT, RecordT]], where: str) -> dict[KeyT, RecordT]:
    found: dict[KeyT, RecordT] = {}
    for key, record in pairs:
        if key in found:
            raise ConfigError(f"{where} {key if isinstance(key, str) else f'0x{key:02X}'} is there twice")
        found[key] = record
    return found


def _record(record: type[RecordT], entry: object, where: str, access: Mapping[str, Access]) -> RecordT:
    table = _mapping(entry, where)
    members = {member.name: member for member in fields(record)}  # type: ignore[arg-type]  # every caller passes a dataclass
    required = {
        name for name, member in members.items() if member.default is MISSING and member.default_factory is MISSING
    }
    _check_keys(table, set(members), required, where)
    hints = get_type_hints(record)
    values = {key: _value(hints[key], value, f"{where}: {key}", access) for key, value in table.items()}
    try:
        return record(**values)
    except ConfigError as exc:
        raise ConfigError(f"{where}: {exc}") from exc


def _value(wanted: Any, value: object, where: str, access: Mapping[str, Access]) -> Any:  # noqa: ANN401 - by annotation
    if get_origin(wanted) is UnionType:
        wanted = next(choice for choice in get_args(wanted) if choice is not NoneType)  # TOML has no null
    if wanted is Access:
        return _named_access(value, where, access)
    if get_origin(wanted) is tuple:
        if not isinstance(value, list):
            raise ConfigError(f"{where} must be a list, got {value!r}")
        return tuple(
            _value(get_args(wanted)[0], entry, f"{where} {place}", access) for place, entry in enumerate(value, 1)
        )
    if get_origin(wanted) is Mapping:
        return {key: _value(str, text, f"{where}.{key}", access) for key, text in _mapping(value, where).items()}
    if is_dataclass(wanted):
        return _record(wanted, value, where, access)  # type: ignore[arg-type]  # a class, not an instance
    return _scalar(wanted, value, where)


def _scalar(wanted: Any, value: object, where: str) -> Any:  # noqa: ANN401 - by annotation
    if issubclass(wanted, StrEnum):
        if value not in set(wanted):
            raise ConfigError(f"{where} must be one of {', '.join(wanted)}, got {value!r}")
        return wanted(value)
    kinds = {int: "a whole number", float: "a number", str: "a string", bool: "true or false"}
    is_right = isinstance(value, int | float) if wanted is float else isinstance(value, wanted)
    if not is_right or (wanted is not bool and isinstance(value, bool)):
        raise ConfigError(f"{where} must be {kinds[wanted]}, got {value!r}")
    if wanted is int and value < 0:  # type: ignore[operator]  # an int, by the line above
        raise ConfigError(f"{where} must not be negative, got {value!r}")
    return float(value) if wanted is float else value  # type: ignore[arg-type]  # likewise


def _named_access(value: object, where: str, access: Mapping[str, Access]) -> Access:
    if not isinstance(value, str) or value not in access:
        raise ConfigError(f"{where} must be one of {', '.join(sorted(access))}, got {value!r}")
    return access[value]


def _mapping(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where} must be a table, got {value!r}")
    return value


def _check_keys(table: Mapping[str, object], known: set[str], required: set[str], where: str) -> None:
    if unknown := sorted(set(table) - known):
        raise ConfigError(f"{where}: key {unknown[0]} is unknown; known: {', '.join(sorted(known))}")
    if missing := sorted(required - set(table)):
        raise ConfigError(f"{where}: key {missing[0]} is missing")
