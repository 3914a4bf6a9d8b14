"""The table of a controller, from a TOML file: all of its answers follow from it."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, TypeVar

from canlog.files import read_small_file
from clutch_model.calibration import CONVERTERS
from clutch_model.tables import record_from
from ecu_emulator.errors import EmulatorConfigError
from workshop.controller import descriptions
from workshop.controller.descriptions import AccessRule, DataIdentifier, Routine, Trouble
from workshop.controller.iso14229 import DEFAULT_SESSION


@dataclass(frozen=True, slots=True, kw_only=True)
class Addressing:
    """CAN identifiers: requests to this controller, its responses, requests to all controllers."""

    request_id: int
    response_id: int
    functional_id: int

    def __post_init__(self) -> None:
        ids = (self.request_id, self.response_id, self.functional_id)
        _check(
            max(ids) <= 0x1FFFFFFF and len(set(ids)) == len(ids), "three identifiers, of 29 bits at most, must differ"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Transport:
    """Choices that ISO-TP leaves open."""

    padding: int | None = None  # byte that pads frames to eight bytes; None: no padding
    block_size: int = 8  # frames between two flow controls; 0: all
    separation_time: int = 0  # STmin for clients, as coded on the wire
    own_address: int | None = None  # extended addressing: first byte of frames to this controller
    tester_address: int = 0xF1  # first byte of responses
    all_address: int = 0xFE  # first byte of functional requests

    def __post_init__(self) -> None:
        for name in ("padding", "block_size", "separation_time", "own_address", "tester_address", "all_address"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 0xFF:
                raise EmulatorConfigError(f"{name} must be 0..0xFF, got {value}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DoipEntity:
    """The DoIP entity of a controller; addresses and times as ISO 13400-2 has them."""

    logical_address: int = 0x1011
    functional_address: int = 0xE400  # of functional requests
    first_tester: int = 0x0E00  # range of tester addresses
    last_tester: int = 0x0FFF
    activation_types: tuple[int, ...] = (0x00, 0x01)  # default and WWH-OBD
    eid: int = 0x020000001011  # entity identification: a locally administered MAC address
    gid: int = 0x020000001011  # group identification
    version: int = 0x03  # protocol version for testers whose version is unknown
    most_sockets: int = 4
    most_request_bytes: int = 4095
    initial_inactivity_s: float = 2.0  # T_TCP_Initial_Inactivity: until routing is activated
    general_inactivity_s: float = 300.0  # T_TCP_General_Inactivity
    alive_check_s: float = 0.5  # T_TCP_Alive_Check
    announce_wait_s: float = 0.5  # A_DoIP_Announce_Wait: longest random pause before an announcement
    announce_interval_s: float = 0.5
    announce_count: int = 3

    def __post_init__(self) -> None:
        numbers = (self.logical_address, self.functional_address, self.first_tester, self.last_tester)
        _check(min(numbers) >= 1 and max(numbers) <= 0xFFFF, "addresses must be 1..0xFFFF")
        _check(self.first_tester <= self.last_tester, "first_tester must not be above last_tester")
        addresses = (self.logical_address, self.functional_address)
        _check(
            addresses[0] != addresses[1]
            and not any(self.first_tester <= number <= self.last_tester for number in addresses),
            "logical_address and functional_address must differ from each other and from those of testers",
        )
        _check(max(self.activation_types, default=0) <= 0xFF, "activation_types must be 0..0xFF")
        _check(max(self.eid, self.gid) < 1 << 48, "eid and gid must have six bytes")
        _check(self.version in {0x02, 0x03}, "version must be 2 (ISO 13400-2:2012) or 3 (:2019)")
        _check(1 <= self.most_sockets <= 0xFF, "most_sockets must be 1..255")
        _check(8 <= self.most_request_bytes <= 4095, "most_request_bytes must be 8..4095")
        _check(self.announce_count <= 10, "announce_count must be at most 10")
        for name in ("initial_inactivity_s", "general_inactivity_s", "alive_check_s", "announce_interval_s"):
            _check(0.0 < getattr(self, name) <= 3600.0, f"{name} must be above 0 and at most 3600 s")
        _check(0.0 <= self.announce_wait_s <= 10.0, "announce_wait_s must be 0..10 s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Times of ISO 14229-2."""

    p2_s: float
    p2_star_s: float
    s3_s: float
    reset_s: float  # duration of a reset
    least_answer_s: float = 0.0  # time to answer, uniformly distributed up to the next
    most_answer_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestLimits:
    """Limits of one request."""

    most_data: int  # identifiers in one request
    most_response_bytes: int
    most_pieces: int  # of all defined data identifiers

    def __post_init__(self) -> None:
        _check(self.most_data >= 1, "most_data must be at least 1")
        _check(8 <= self.most_response_bytes <= 4095, "most_response_bytes must be 8..4095, what ISO-TP carries")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchLimits:
    """Limits of a clutch in monitors and adaptation; all [C]."""

    most_temperature_k: float = 423.15  # 150 degC, computed temperature of the pack
    most_touch_change_pa: float = 0.25e5  # from the touch point of the type: five standard deviations

    def __post_init__(self) -> None:
        _check(273.15 <= self.most_temperature_k <= 1273.15, "clutches.most_temperature_k must be 273.15..1273.15 K")
        _check(0.0 < self.most_touch_change_pa <= 0.3e5, "clutches.most_touch_change_pa must be above 0, at most 0.3e5")


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosticTable:
    """Services, data, routines, codes and settings of a controller, by number."""

    name: str
    addressing: Addressing
    transport: Transport
    timing: Timing
    limits: RequestLimits
    sessions: Mapping[int, descriptions.DiagnosticSession]
    levels: Mapping[int, descriptions.SecurityLevel]
    services: Mapping[int, descriptions.ServiceAccess]
    conditions: Mapping[str, descriptions.Precondition]
    data: Mapping[int, descriptions.DataIdentifier]
    routines: Mapping[int, descriptions.Routine]
    troubles: Mapping[int, descriptions.Trouble]
    extended: Mapping[int, descriptions.ExtendedRecord]
    snapshot: tuple[int, ...]  # data of the snapshots of trouble codes
    obd: descriptions.Obd | None = None
    doip: DoipEntity = field(default_factory=DoipEntity)
    clutches: ClutchLimits = field(default_factory=ClutchLimits)

    def __post_init__(self) -> None:
        _check(DEFAULT_SESSION in self.sessions, "sessions must have number 1, the default session")
        for where, numbers, most in (
            ("session", self.sessions, 0x7E),
            ("service", self.services, 0xFF),
            ("data", self.data, 0xFFFF),
            ("routine", self.routines, 0xFFFF),
        ):
            highest = max(numbers, default=0)
            _check(highest <= most, f"{where} 0x{highest:X} is above 0x{most:X}")
        for access, where in self._accesses():
            _check_known(access.sessions, self.sessions, f"{where}: session")
            _check_known(access.levels, self.levels, f"{where}: security level")
            _check_known(access.conditions, self.conditions, f"{where}: condition")
        for routine in self.routines.values():
            _check_known(routine.held_conditions, self.conditions, f"routine {routine.name}: condition")
        for level in self.levels.values():
            _check_known(level.sessions, self.sessions, f"security level {level.name}: session")
        if self.obd is not None:
            _check_known(self.obd.clear_conditions, self.conditions, "obd_clear_conditions: condition")
            codes = {trouble.code: trouble for trouble in self.troubles.values()}
            for monitor in self.obd.monitors.values():
                _check_known((monitor.code,), codes, f"monitor 0x{monitor.number:02X}: trouble code")
            for info in self.obd.infos.values():
                _check_known(
                    () if info.data is None else (info.data,), self.data, f"vehicle information {info.name}: data"
                )
        _check_known(self.snapshot, self.data, "snapshot: data")
        for name, most_s in (("p2_s", 65.0), ("p2_star_s", 600.0), ("s3_s", 600.0)):  # two bytes of ms, and of 10 ms
            time_s = getattr(self.timing, name)
            _check(0.0 < time_s <= most_s, f"timing.{name} must be above 0 and at most {most_s:g} s, got {time_s}")
        least_s, most_s = self.timing.least_answer_s, self.timing.most_answer_s
        _check(0.0 <= least_s <= most_s < self.timing.p2_s, "0 <= timing.least_answer_s <= most_answer_s < p2_s")

    def _accesses(self) -> Iterable[tuple[descriptions.AccessRule | descriptions.ServiceAccess, str]]:
        for service in self.services.values():
            yield service, f"service {service.name}"
        for datum in self.data.values():
            for access in (datum.read, datum.write):
                if access is not None:
                    yield access, f"data {datum.name}"
        for routine in self.routines.values():
            yield routine.access, f"routine {routine.name}"


def _check_known(
    names: Iterable[object], known: Mapping[object, object] | Mapping[int, object] | Mapping[str, object], where: str
) -> None:
    for name in names:
        _check(name in known, f"{where} {name if isinstance(name, str) else f'0x{name:02X}'} is not described")


def _check(holds: bool, message: str) -> None:  # noqa: FBT001 - reads as a sentence at the call
    if not holds:
        raise EmulatorConfigError(message)


RecordT = TypeVar("RecordT")
KeyT = TypeVar("KeyT", int, str)

_LIKE: Final = "like_"
_SAME_IN_FILES: Final = (  # of a table
    *("name", "snapshot", "addressing", "transport", "timing", "limits", "doip", "clutches"),
)
_ACCESSES: Final = ("access", "read", "write")  # members that name an entry of [access]
_MAY_BE_NEGATIVE: Final = frozenset({"offset", "minimum", "maximum"})


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFile:
    """The content of a TOML file, without its table [access]."""

    name: str
    snapshot: tuple[int, ...]
    addressing: Addressing
    transport: Transport
    timing: Timing
    limits: RequestLimits
    session: tuple[descriptions.DiagnosticSession, ...] = ()
    security: tuple[descriptions.SecurityLevel, ...] = ()
    service: tuple[descriptions.ServiceAccess, ...] = ()
    condition: tuple[descriptions.Precondition, ...] = ()
    data: tuple[DataIdentifier, ...] = ()
    routine: tuple[Routine, ...] = ()
    trouble: tuple[Trouble, ...] = ()
    extended: tuple[descriptions.ExtendedRecord, ...] = ()
    obd: bool = False  # whether SAE J1979 is answered
    obd_clear_conditions: tuple[str, ...] = ()
    pid: tuple[descriptions.Pid, ...] = ()
    vehicle_info: tuple[descriptions.VehicleInfo, ...] = ()
    monitor: tuple[descriptions.MonitorTest, ...] = ()
    doip: DoipEntity = field(default_factory=DoipEntity)
    clutches: ClutchLimits = field(default_factory=ClutchLimits)


@cache
def shipped_table() -> DiagnosticTable:
    """Return the table of the emulated transmission controller."""
    return parse_table(_shipped_text("tcu"), "tcu.toml")


@cache
def table_of(transmission: str) -> DiagnosticTable:
    """Return the table of a transmission; one with a converter has further data and codes."""
    shipped = shipped_table()
    if transmission not in CONVERTERS:
        return shipped
    document = tomllib.loads(_shipped_text("converter"))
    troubles = _numbered(_records(Trouble, document, "trouble"), "trouble")
    return replace(_with_data(shipped, document), troubles={**shipped.troubles, **troubles})


def personalities() -> tuple[str, ...]:
    """Return the names of the controllers of real cars that can be emulated."""
    names = (entry.name for entry in files("workshop.controller").iterdir())
    return tuple(sorted(name[len(_LIKE) : -len(".toml")] for name in names if name.startswith(_LIKE)))


def check_personality(name: str) -> None:
    """Raise ConfigError if there is no such personality."""
    if name not in personalities():
        raise EmulatorConfigError(f"nobody answers like {name}: there are {', '.join(personalities())}")


@cache
def engine_table() -> DiagnosticTable:
    """Return the table of the engine's controller beside a transmission's of a real car."""
    return parse_table(_shipped_text("engine"), "engine.toml")


@cache
def table_like(name: str, transmission: str = "nominal") -> DiagnosticTable:
    """Return the table of a transmission with the data, addresses and answer times of a controller of a real car.

    Raises ConfigError if there is no such personality, or it is of another kind of transmission.
    """
    check_personality(name)
    document, table = tomllib.loads(_shipped_text(f"{_LIKE}{name}")), table_of(transmission)
    if document["has_converter"] != (transmission in CONVERTERS):
        what = "an automatic with a converter" if document["has_converter"] else "a dual clutch"
        raise EmulatorConfigError(f"{name} answers for {what}, and the transmission is {transmission}")
    return replace(
        _with_data(table, document),
        addressing=replace(table.addressing, **document.get("addressing", {})),
        timing=replace(table.timing, **document["timing"]),
        limits=replace(table.limits, **document["limits"]),
    )


def _shipped_text(name: str) -> str:
    return files("workshop.controller").joinpath(f"{name}.toml").read_text(encoding="utf-8")


def _with_data(table: DiagnosticTable, document: Mapping[str, Any]) -> DiagnosticTable:
    """Return a table with another name and further data, readable in every session."""
    access = {"open": AccessRule(sessions=tuple(table.sessions))}
    data = _numbered(_records(DataIdentifier, _with_access(document, access), "data"), "data")
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
        raise EmulatorConfigError(f"cannot read {path}: {exc.strerror or exc}") from exc
    except UnicodeDecodeError as exc:
        raise EmulatorConfigError(f"{path} is not UTF-8") from exc


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
        raise EmulatorConfigError(f"{where} is not TOML: {exc}") from exc
    try:
        return _table(document)
    except EmulatorConfigError as exc:
        raise EmulatorConfigError(f"{where}: {exc}") from exc


def _table(document: dict[str, Any]) -> DiagnosticTable:
    _check_signs(document)
    access_table = document.pop("access", None)
    if not isinstance(access_table, Mapping):
        raise EmulatorConfigError("access is missing: a table that says who may use what")
    access = {
        name: record_from(AccessRule, rule, f"access.{name}: ", error=EmulatorConfigError)
        for name, rule in access_table.items()
    }
    file = record_from(TableFile, _with_access(document, access), error=EmulatorConfigError)
    return DiagnosticTable(
        **{name: getattr(file, name) for name in _SAME_IN_FILES},
        sessions=_numbered(file.session, "session"),
        levels=_numbered(file.security, "security"),
        services=_numbered(file.service, "service"),
        conditions=_unique([(entry.name, entry) for entry in file.condition], "condition"),
        data=_numbered(file.data, "data"),
        routines=_numbered(file.routine, "routine"),
        troubles=_numbered(file.trouble, "trouble"),
        extended=_numbered(file.extended, "extended"),
        obd=_obd(file),
    )


def _obd(file: TableFile) -> descriptions.Obd | None:
    if not file.obd:
        if unused := [key for key in ("monitor", "obd_clear_conditions", "pid", "vehicle_info") if getattr(file, key)]:
            raise EmulatorConfigError(f"{unused[0]} is there, but not obd = true: OBD is not answered")
        return None
    return descriptions.Obd(
        clear_conditions=file.obd_clear_conditions,
        pids=_numbered(file.pid, "pid"),
        infos=_numbered(file.vehicle_info, "vehicle_info"),
        monitors=_numbered(file.monitor, "monitor"),
    )


def _records(record: type[RecordT], document: Mapping[str, Any], key: str) -> tuple[RecordT, ...]:
    return tuple(record_from(record, entry, f"{key}: ", error=EmulatorConfigError) for entry in document[key])


def _check_signs(value: object, where: str = "") -> None:
    """Raise ConfigError if a whole number is negative, but for offsets and limits."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _check_signs(None if key in _MAY_BE_NEGATIVE else inner, f"{where}{key}.")
    elif isinstance(value, list):
        for row, inner in enumerate(value, 1):
            _check_signs(inner, f"{where.rstrip('.')} {row}.")
    elif isinstance(value, int) and value < 0:
        raise EmulatorConfigError(f"{where.rstrip('.')} must not be negative, got {value!r}")


def _with_access(document: Mapping[str, Any], access: Mapping[str, AccessRule]) -> dict[str, Any]:
    """Return a document with names of access rules in data and routines replaced by the rules."""
    resolved = {key: _resolved(document[key], key, access) for key in ("data", "routine") if key in document}
    return {**document, **resolved}


def _resolved(entries: object, where: str, access: Mapping[str, AccessRule]) -> object:
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        return entries
    for row, entry in enumerate(entries, 1):
        for key in entry.keys() & set(_ACCESSES):
            if not isinstance(entry[key], str) or entry[key] not in access:
                names = ", ".join(sorted(access))
                raise EmulatorConfigError(f"{where} {row}: {key} must be one of {names}, got {entry[key]!r}")
    return [{key: access[value] if key in _ACCESSES else value for key, value in entry.items()} for entry in entries]


def _numbered(records: tuple[RecordT, ...], where: str) -> dict[int, RecordT]:
    return _unique([(record.number, record) for record in records], where)  # type: ignore[attr-defined]  # every caller's has it


def _unique(pairs: list[tuple[KeyT, RecordT]], where: str) -> dict[KeyT, RecordT]:
    by_key: dict[KeyT, RecordT] = {}
    for key, record in pairs:
        if key in by_key:
            raise EmulatorConfigError(f"{where} {key if isinstance(key, str) else f'0x{key:02X}'} is there twice")
        by_key[key] = record
    return by_key
