"""What a controller can be asked: data, routines, trouble codes and who may use them; the rest follows from it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from ecu_emulator.diagnostics.codes import DEFAULT_SESSION, Nrc
from ecu_emulator.errors import ConfigError

_SYSTEMS: Final = "PCBU"  # powertrain, chassis, body, network: the two upper bits of a code
_CODE: Final = re.compile(r"[PCBU][0-3][0-9A-F]{3}")


class Kind(StrEnum):
    """How a value is written into bytes, big-endian."""

    UNSIGNED = "unsigned"
    SIGNED = "signed"
    TEXT = "text"
    BYTES = "bytes"


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One value within the bytes of a datum, a routine's options or results, or an extended record."""

    name: str
    kind: Kind
    size_bytes: int
    source: str = ""  # which value of the controller it shows, in SI
    unit: str = ""  # as it is on the wire
    resolution: float = 1.0  # of one bit, in that unit
    offset: float = 0.0
    minimum: float | None = None  # what may be written, in that unit
    maximum: float | None = None
    pattern: str = ""  # what a text may be, as a regular expression
    meanings: Mapping[str, str] = field(default_factory=dict)  # of numbers

    def __post_init__(self) -> None:
        if not 1 <= self.size_bytes <= 255:
            raise ConfigError(f"{self.name}: size_bytes must be 1..255, got {self.size_bytes}")
        if self.kind in {Kind.UNSIGNED, Kind.SIGNED} and self.size_bytes > 8:
            raise ConfigError(f"{self.name}: a number has at most 8 bytes, got {self.size_bytes}")
        if not self.resolution > 0.0:
            raise ConfigError(f"{self.name}: resolution must be > 0, got {self.resolution}")
        try:
            re.compile(self.pattern)
        except re.error as exc:
            raise ConfigError(f"{self.name}: pattern is no regular expression: {exc}") from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Who may do something, and in which condition of the vehicle."""

    sessions: tuple[int, ...]
    levels: tuple[int, ...] = ()  # one of these must be unlocked; none is needed if there is none
    conditions: tuple[str, ...] = ()  # checked in this order


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """What must hold of a value of the controller, and the response if it does not."""

    name: str
    source: str
    nrc: int
    minimum: float | None = None  # in SI
    maximum: float | None = None

    def __post_init__(self) -> None:
        if self.nrc not in set(Nrc):
            raise ConfigError(f"condition {self.name}: nrc 0x{self.nrc:02X} is unknown")


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """A diagnostic session, and from which others it can be entered."""

    number: int
    name: str
    from_sessions: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SecurityLevel:
    """A lock: the number that asks for its seed; key = seed XOR mask."""

    number: int
    name: str
    sessions: tuple[int, ...]
    seed_bytes: int
    key_mask: int
    most_attempts: int
    delay_s: float  # after so many wrong keys

    def __post_init__(self) -> None:
        if self.number % 2 == 0 or not 0x01 <= self.number <= 0x41:
            raise ConfigError(f"security level {self.name}: its number must be odd, 1..0x41, got {self.number}")
        if not 0 < self.key_mask < 1 << (8 * self.seed_bytes):
            raise ConfigError(f"security level {self.name}: key_mask must fit {self.seed_bytes} bytes and not be 0")
        if self.most_attempts < 1 or self.delay_s < 0.0:
            raise ConfigError(f"security level {self.name}: most_attempts must be >= 1 and delay_s >= 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceAccess:
    """In which sessions a service is there, and in which condition of the vehicle it changes something."""

    number: int
    name: str
    sessions: tuple[int, ...]
    levels: tuple[int, ...] = ()
    conditions: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Datum:
    """A data identifier: live (its fields have sources) or stored (it has an initial value)."""

    number: int
    name: str
    fields: tuple[Field, ...]
    read: Access
    initial: str | None = None  # text, or hexadecimal digits of all its bytes
    write: Access | None = None
    control: Access | None = None  # by service 2F

    def __post_init__(self) -> None:
        are_live = [bool(entry.source) for entry in self.fields]
        if not self.fields or any(are_live) != all(are_live) or all(are_live) != (self.initial is None):
            raise ConfigError(f"data {self.name}: either every field has a source, or there is an initial value")
        if self.write is not None and self.initial is None:
            raise ConfigError(f"data {self.name}: what is live cannot be written")
        if self.control is not None and self.initial is not None:
            raise ConfigError(f"data {self.name}: what is stored cannot be controlled")

        if self.initial is not None and len(self.initial_bytes) != self.size_bytes:
            raise ConfigError(f"data {self.name}: initial must have {self.size_bytes} bytes, got {self.initial!r}")

    @property
    def size_bytes(self) -> int:
        """Length of its data [byte]."""
        return size_of(self.fields)

    @property
    def initial_bytes(self) -> bytes:
        """What it holds before it was ever written, if it is stored."""
        text = self.initial or ""
        try:
            return text.encode("ascii") if self.fields[0].kind is Kind.TEXT else bytes.fromhex(text)
        except ValueError as exc:
            raise ConfigError(f"data {self.name}: initial is neither ASCII text nor hexadecimal: {text!r}") from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class Routine:
    """A routine: ends by itself after a time, or is ended by the vehicle, within the time at most."""

    number: int
    name: str
    access: Access
    duration_s: float
    ends_by_itself: bool = True
    is_awaited: bool = False  # the positive response to its start comes when it has ended
    can_be_stopped: bool = True
    options: tuple[Field, ...] = ()
    results: tuple[Field, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """A diagnostic trouble code: a code as scan tools show it and a failure type (ISO 15031-6, SAE J2012-DA)."""

    code: str  # P0811
    failure_type: int
    text: str
    severity: int
    lights_lamp: bool
    confirm_cycles: int = 1  # operation cycles with a failure, without a passed one between them
    heal_cycles: int = 3  # passed cycles until the lamp goes out
    age_cycles: int = 40  # passed warm-up cycles until the code is forgotten
    failed_step: int = 127  # of the fault detection counter
    passed_step: int = 128
    snapshot: tuple[int, ...] | None = None  # data identifiers; those of the table if there are none
    extended: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        if not _CODE.fullmatch(self.code):
            raise ConfigError(f"trouble code {self.code} is none: a letter of {_SYSTEMS}, a digit 0-3, three of 0-F")
        for name, value, most in (
            ("failure_type", self.failure_type, 255), ("severity", self.severity, 255),
            ("confirm_cycles", self.confirm_cycles, 255), ("heal_cycles", self.heal_cycles, 255),
            ("age_cycles", self.age_cycles, 255), ("failed_step", self.failed_step, 127),
            ("passed_step", self.passed_step, 128),
        ):  # fmt: skip
            least = 0 if name in {"failure_type", "severity"} else 1
            if not least <= value <= most:
                raise ConfigError(f"trouble code {self.code}: {name} must be {least}..{most}, got {value}")

    @property
    def number(self) -> int:
        """The three bytes that stand for it on the wire."""
        upper = _SYSTEMS.index(self.code[0]) << 14 | int(self.code[1:], 16)
        return upper << 8 | self.failure_type


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedRecord:
    """A record of extended data: counters of the trouble code, or values kept at the moment of failure."""

    number: int
    name: str
    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        if not 0x01 <= self.number <= 0xEF:
            raise ConfigError(f"extended record {self.name}: its number must be 1..0xEF, got {self.number}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Addressing:
    """CAN identifiers: requests to this controller, its responses, requests to all controllers."""

    request_id: int
    response_id: int
    functional_id: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Transport:
    """How ISO-TP behaves where the standard leaves a choice."""

    padding: int | None = None  # every frame is filled up to eight bytes with it; without it short ones are sent
    block_size: int = 8  # frames that a client may send before it asks again; 0 all
    separation_time: int = 0  # STmin that is asked of clients, as coded on the wire
    own_address: int | None = None  # extended addressing: the byte before everything that is sent to this controller
    tester_address: int = 0xF1  # likewise in responses
    all_address: int = 0xFE  # likewise in requests to all

    def __post_init__(self) -> None:
        for name in ("padding", "block_size", "separation_time", "own_address", "tester_address", "all_address"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 0xFF:
                raise ConfigError(f"{name} must be 0..0xFF, got {value}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Times of ISO 14229-2."""

    p2_s: float
    p2_star_s: float
    s3_s: float
    reset_s: float  # from a reset until the controller listens again


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much one request may ask for."""

    most_data: int  # identifiers in one request
    most_response_bytes: int
    most_pieces: int  # of data identifiers that the client defined, in all


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosticTable:
    """Everything a controller can be asked, by number."""

    name: str
    addressing: Addressing
    transport: Transport
    timing: Timing
    limits: Limits
    sessions: Mapping[int, Session]
    levels: Mapping[int, SecurityLevel]
    services: Mapping[int, ServiceAccess]
    conditions: Mapping[str, Condition]
    data: Mapping[int, Datum]
    routines: Mapping[int, Routine]
    troubles: Mapping[int, Trouble]
    extended: Mapping[int, ExtendedRecord]
    snapshot: tuple[int, ...]  # data kept with every trouble code that names none itself

    def __post_init__(self) -> None:
        _check(DEFAULT_SESSION in self.sessions, "sessions must have number 1, the default session")
        for access, where in self._accesses():
            _check_known(access.sessions, self.sessions, f"{where}: session")
            _check_known(access.levels, self.levels, f"{where}: security level")
            _check_known(access.conditions, self.conditions, f"{where}: condition")
        for level in self.levels.values():
            _check_known(level.sessions, self.sessions, f"security level {level.name}: session")
        for trouble in self.troubles.values():
            _check_known(self.snapshot_of(trouble), self.data, f"trouble code {trouble.code}: data")
            _check_known(self.extended_of(trouble), self.extended, f"trouble code {trouble.code}: extended record")
        for name, value in (
            ("p2_s", self.timing.p2_s),
            ("p2_star_s", self.timing.p2_star_s),
            ("s3_s", self.timing.s3_s),
        ):
            _check(0.0 < value <= 600.0, f"timing.{name} must be above 0 and at most 600 s, got {value}")

    def snapshot_of(self, trouble: Trouble) -> tuple[int, ...]:
        """Return the data identifiers of a trouble code's snapshots."""
        return self.snapshot if trouble.snapshot is None else trouble.snapshot

    def extended_of(self, trouble: Trouble) -> tuple[int, ...]:
        """Return the numbers of a trouble code's extended records."""
        return tuple(self.extended) if trouble.extended is None else trouble.extended

    def _accesses(self) -> Iterable[tuple[Access | ServiceAccess, str]]:
        for service in self.services.values():
            yield service, f"service {service.name}"
        for datum in self.data.values():
            for access in (datum.read, datum.write, datum.control):
                if access is not None:
                    yield access, f"data {datum.name}"
        for routine in self.routines.values():
            yield routine.access, f"routine {routine.name}"


def size_of(fields: Iterable[Field]) -> int:
    """Return the length of fields [byte]."""
    return sum(entry.size_bytes for entry in fields)


def _check_known(
    names: Iterable[object], known: Mapping[object, object] | Mapping[int, object] | Mapping[str, object], where: str
) -> None:
    for name in names:
        _check(name in known, f"{where} {name if isinstance(name, str) else f'0x{name:02X}'} is not described")


def _check(holds: bool, message: str) -> None:  # noqa: FBT001 - reads as a sentence at the call
    if not holds:
        raise ConfigError(message)
