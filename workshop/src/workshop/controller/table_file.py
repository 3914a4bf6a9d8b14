"""The table of a controller's diagnosis from a TOML file; each key is checked, the first wrong one is named."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, TypeVar

from canlog.files import read_small_file
from clutch_model.calibration import CONVERTERS
from clutch_model.tables import record_from
from ecu_emulator.errors import ConfigError
from workshop.controller import descriptions
from workshop.controller.descriptions import Access, Datum, Profile, Routine, Trouble
from workshop.controller.table import (
    Addressing,
    ClutchLimits,
    DiagnosticTable,
    DoipEntity,
    Limits,
    Periodic,
    Timing,
    Transport,
)

RecordT = TypeVar("RecordT")
KeyT = TypeVar("KeyT", int, str)

_LIKE: Final = "like_"
_SAME_IN_FILES: Final = (  # of a table
    *("name", "snapshot", "addressing", "transport", "timing", "limits", "doip", "periodic", "clutches"),
)
_ACCESSES: Final = ("access", "read", "write", "control")  # members that name one of the table [access]
_MAY_BE_NEGATIVE: Final = frozenset({"offset", "minimum", "maximum"})


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFile:
    """What a TOML file may hold, but for the table that says who may use what."""

    name: str
    snapshot: tuple[int, ...]
    addressing: Addressing
    transport: Transport
    timing: Timing
    limits: Limits
    session: tuple[descriptions.Session, ...] = ()
    security: tuple[descriptions.SecurityLevel, ...] = ()
    service: tuple[descriptions.ServiceAccess, ...] = ()
    condition: tuple[descriptions.Condition, ...] = ()
    data: tuple[Datum, ...] = ()
    routine: tuple[Routine, ...] = ()
    trouble: tuple[Trouble, ...] = ()
    extended: tuple[descriptions.ExtendedRecord, ...] = ()
    obd: Profile | None = None
    obd_clear_conditions: tuple[str, ...] = ()
    pid: tuple[descriptions.Pid, ...] = ()
    vehicle_info: tuple[descriptions.VehicleInfo, ...] = ()
    monitor: tuple[descriptions.MonitorTest, ...] = ()
    doip: DoipEntity = field(default_factory=DoipEntity)
    periodic: Periodic | None = None
    clutches: ClutchLimits = field(default_factory=ClutchLimits)


@cache
def shipped_table() -> DiagnosticTable:
    """Return the table of the emulated transmission controller."""
    return parse_table(_shipped_text("tcu"), "tcu.toml")


@cache
def table_of(transmission: str) -> DiagnosticTable:
    """Return the table of the controller of a transmission: one of a converter has data and codes of its own."""
    shipped = shipped_table()
    if transmission not in CONVERTERS:
        return shipped
    document = tomllib.loads(_shipped_text("converter"))
    own = _numbered(_records(Trouble, document, "trouble"), "trouble")
    return replace(_with_data(shipped, document), troubles={**shipped.troubles, **own})


def personalities() -> tuple[str, ...]:
    """Return the names of controllers of real cars that the emulated one can answer like."""
    found = (one.name for one in files("workshop.controller").iterdir())
    return tuple(sorted(name[len(_LIKE) : -len(".toml")] for name in found if name.startswith(_LIKE)))


@cache
def table_like(name: str, transmission: str = "nominal") -> DiagnosticTable:
    """Return the table of a transmission with the data that another controller has besides, and its times to answer.

    Raises ConfigError if there is no such personality.
    """
    if name not in personalities():
        raise ConfigError(f"nobody answers like {name}: there are {', '.join(personalities())}")
    document, own = tomllib.loads(_shipped_text(f"{_LIKE}{name}")), table_of(transmission)
    return replace(
        _with_data(own, document),
        timing=replace(own.timing, **document["timing"]),
        limits=replace(own.limits, **document["limits"]),
    )


def _shipped_text(name: str) -> str:
    return files("workshop.controller").joinpath(f"{name}.toml").read_text(encoding="utf-8")


def _with_data(table: DiagnosticTable, document: Mapping[str, Any]) -> DiagnosticTable:
    """Return a table under another name, with more data that may be read in every session."""
    access = {"open": Access(sessions=tuple(table.sessions))}
    data = _numbered(_records(Datum, _with_access(document, access), "data"), "data")
    return replace(table, name=document["name"], data={**table.data, **data})


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


def _table(document: dict[str, Any]) -> DiagnosticTable:
    _check_signs(document)
    told = document.pop("access", None)
    if not isinstance(told, Mapping):
        raise ConfigError("access is missing: a table that says who may use what")
    access = {name: record_from(Access, one, f"access.{name}: ", error=ConfigError) for name, one in told.items()}
    file = record_from(TableFile, _with_access(document, access), error=ConfigError)
    extended = _numbered(file.extended, "extended")
    if file.obd is Profile.UDS:
        extended.setdefault(descriptions.IN_USE.number, descriptions.IN_USE)
    return DiagnosticTable(
        **{name: getattr(file, name) for name in _SAME_IN_FILES},
        sessions=_numbered(file.session, "session"),
        levels=_numbered(file.security, "security"),
        services=_numbered(file.service, "service"),
        conditions=_unique([(entry.name, entry) for entry in file.condition], "condition"),
        data=_numbered(file.data, "data"),
        routines=_numbered(file.routine, "routine"),
        troubles=_numbered(file.trouble, "trouble"),
        extended=extended,
        obd=_obd(file),
    )


def _obd(file: TableFile) -> descriptions.Obd | None:
    if file.obd is None:
        if unused := [one for one in ("monitor", "obd_clear_conditions", "pid", "vehicle_info") if getattr(file, one)]:
            raise ConfigError(f"{unused[0]} is there, but key obd is missing: it says how OBD is spoken")
        return None
    return descriptions.Obd(
        profile=file.obd,
        clear_conditions=file.obd_clear_conditions,
        pids=_numbered(file.pid, "pid"),
        infos=_numbered(file.vehicle_info, "vehicle_info"),
        monitors=_numbered(file.monitor, "monitor"),
    )


def _records(record: type[RecordT], document: Mapping[str, Any], key: str) -> tuple[RecordT, ...]:
    return tuple(record_from(record, one, f"{key}: ", error=ConfigError) for one in document[key])


def _check_signs(value: object, where: str = "") -> None:
    """Raise ConfigError if a whole number is negative that must not be."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _check_signs(None if key in _MAY_BE_NEGATIVE else inner, f"{where}{key}.")
    elif isinstance(value, list):
        for row, inner in enumerate(value, 1):
            _check_signs(inner, f"{where.rstrip('.')} {row}.")
    elif isinstance(value, int) and value < 0:
        raise ConfigError(f"{where.rstrip('.')} must not be negative, got {value!r}")


def _with_access(document: Mapping[str, Any], access: Mapping[str, Access]) -> dict[str, Any]:
    """Return a document in which who may use data and routines stands in place of the names for that."""
    told = {key: _resolved(document[key], key, access) for key in ("data", "routine") if key in document}
    return {**document, **told}


def _resolved(entries: object, where: str, access: Mapping[str, Access]) -> object:
    if not isinstance(entries, list) or not all(isinstance(one, Mapping) for one in entries):
        return entries
    for row, entry in enumerate(entries, 1):
        for key in entry.keys() & set(_ACCESSES):
            if not isinstance(entry[key], str) or entry[key] not in access:
                names = ", ".join(sorted(access))
                raise ConfigError(f"{where} {row}: {key} must be one of {names}, got {entry[key]!r}")
    return [{key: access[one] if key in _ACCESSES else one for key, one in entry.items()} for entry in entries]


def _numbered(records: tuple[RecordT, ...], where: str) -> dict[int, RecordT]:
    return _unique([(record.number, record) for record in records], where)  # type: ignore[attr-defined]  # every caller's has it


def _unique(pairs: list[tuple[KeyT, RecordT]], where: str) -> dict[KeyT, RecordT]:
    found: dict[KeyT, RecordT] = {}
    for key, record in pairs:
        if key in found:
            raise ConfigError(f"{where} {key if isinstance(key, str) else f'0x{key:02X}'} is there twice")
        found[key] = record
    return found
