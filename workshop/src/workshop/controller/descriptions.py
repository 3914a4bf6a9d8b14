"""Records of a table: data, routines, trouble codes, security levels; and the coding of values as bytes."""

import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from clutch_model import units
from ecu_emulator.errors import EmulatorConfigError
from workshop.controller.iso14229 import Nrc

OF_MEMORY: Final = "memory."  # prefix of sources that are counters of a trouble code
FLOAT_BYTES: Final = frozenset({4, 8})
_SYSTEMS: Final = "PCBU"  # powertrain, chassis, body, network: the two upper bits of a code
_CODE: Final = re.compile(r"[PCBU][0-3][0-9A-F]{3}")

Conversion = Callable[[float], float]
_CONVERSIONS: Final[Mapping[tuple[str, str], Conversion]] = {  # from SI
    ("rad_s", "rpm"): units.rpm_from_rad_s,
    ("pa", "bar"): units.bar_from_pa,
    ("pa", "kPa"): lambda pressure_pa: pressure_pa / 1e3,
    ("k", "degC"): units.degc_from_k,
    ("m_s", "km/h"): units.km_h_from_m_s,
    ("m", "km"): lambda length_m: length_m / 1e3,
    ("ratio", "%"): lambda ratio: ratio * 1e2,
}
_SI_UNITS: Final = {"rad_s": "rad/s", "m_s": "m/s", "s": "s", "pa": "Pa", "k": "K", "nm": "Nm", "m": "m", "ratio": ""}


class Coding(StrEnum):
    """Coding of a value, big-endian."""

    UNSIGNED = "unsigned"
    SIGNED = "signed"
    FLOAT = "float"  # IEEE 754, of 4 or 8 bytes; not a number: not available
    TEXT = "text"
    BYTES = "bytes"


class Task(StrEnum):
    """Action of the vehicle while a routine runs."""

    NOTHING = "nothing"
    REVS = "revs"  # workshop routine: revs with open, then closed clutches, numbers as options; then a drive
    NEW_FLUID = "new_fluid"  # return to the touch points of the type
    TOUCH_POINTS = "touch_points"  # both clutches are adapted


@dataclass(frozen=True, slots=True, kw_only=True)
class DatumField:
    """One value within the bytes of a datum, a routine's options or results, or an extended record."""

    name: str
    kind: Coding
    size_bytes: int
    source: str = ""  # value of the controller, in SI
    unit: str = ""  # as it is on the wire
    resolution: float = 1.0  # of one bit, in that unit
    offset: float = 0.0
    minimum: float | None = None  # limits of a written value, in that unit
    maximum: float | None = None
    pattern: str = ""  # regular expression of a valid text, or of the digits of bytes
    meanings: Mapping[str, str] = field(default_factory=dict)  # of numbers

    def __post_init__(self) -> None:
        if not 1 <= self.size_bytes <= 255:
            raise EmulatorConfigError(f"{self.name}: size_bytes must be 1..255, got {self.size_bytes}")
        if self.kind in {Coding.UNSIGNED, Coding.SIGNED} and self.size_bytes > 8:
            raise EmulatorConfigError(f"{self.name}: a number has at most 8 bytes, got {self.size_bytes}")
        is_scaled = self.resolution != 1.0 or self.offset != 0.0
        if self.kind is Coding.FLOAT and (self.size_bytes not in FLOAT_BYTES or is_scaled):
            raise EmulatorConfigError(f"{self.name}: a float has 4 or 8 bytes and is not scaled")
        if not (math.isfinite(self.resolution) and math.isfinite(self.offset) and self.resolution > 0.0):
            raise EmulatorConfigError(f"{self.name}: resolution must be > 0, and it and the offset finite")
        _check_limits(self)
        known = [
            _SI_UNITS.get(self.dimension, ""),
            *(unit for dimension, unit in _CONVERSIONS if dimension == self.dimension),
        ]
        if self.dimension and self.unit not in {"", *known}:
            raise EmulatorConfigError(
                f"{self.name}: the unit of {self.source} is one of {', '.join(known)}, not {self.unit}"
            )
        try:
            re.compile(self.pattern)
        except re.error as exc:
            raise EmulatorConfigError(f"{self.name}: pattern is not a regular expression: {exc}") from exc
        bits = 8 * self.size_bytes
        if any(not 0 <= number < 1 << bits for number in self.numbered_meanings):
            raise EmulatorConfigError(f"{self.name}: meanings are of numbers from 0 to {(1 << bits) - 1}")

    @property
    def dimension(self) -> str:
        """Unit suffix of the source, empty without one."""
        return next((dimension for dimension in _SI_UNITS if self.source.endswith(f"_{dimension}")), "")

    @property
    def conversion(self) -> Conversion:
        """Conversion of a value from SI to the unit on the wire."""
        return _CONVERSIONS.get((self.dimension, self.unit), float)

    @property
    def numbered_meanings(self) -> dict[int, str]:
        """Texts by number on the wire."""
        try:
            return {int(number, 0): text for number, text in self.meanings.items()}
        except ValueError as exc:
            raise EmulatorConfigError(
                f"{self.name}: meanings are of whole numbers, got {sorted(self.meanings)}"
            ) from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class AccessRule:
    """Sessions, security levels and conditions that something needs."""

    sessions: tuple[int, ...]
    levels: tuple[int, ...] = ()  # one of these must be unlocked; empty: no security
    conditions: tuple[str, ...] = ()  # checked in this order


@dataclass(frozen=True, slots=True, kw_only=True)
class Precondition:
    """A range of a value of the controller, and the response code outside of it."""

    name: str
    source: str
    nrc: int
    minimum: float | None = None  # in SI
    maximum: float | None = None

    def __post_init__(self) -> None:
        if self.nrc not in set(Nrc):
            raise EmulatorConfigError(f"condition {self.name}: nrc 0x{self.nrc:02X} is unknown")
        _check_limits(self)


def _check_limits(entry: DatumField | Precondition) -> None:
    """Raise ConfigError unless the limits are finite and in order."""
    given = [limit for limit in (entry.minimum, entry.maximum) if limit is not None]
    if not all(map(math.isfinite, given)) or given != sorted(given):
        raise EmulatorConfigError(
            f"{entry.name}: minimum and maximum {given} are not a range: leave a missing limit out"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosticSession:
    """A diagnostic session, and the sessions from which it can be entered."""

    number: int
    name: str
    from_sessions: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SecurityLevel:
    """A security level by the sub-function of its seed; key = seed XOR mask."""

    number: int
    name: str
    sessions: tuple[int, ...]
    seed_bytes: int
    key_mask: int
    most_attempts: int
    delay_s: float  # after `most_attempts` wrong keys

    def __post_init__(self) -> None:
        if self.number % 2 == 0 or not 0x01 <= self.number <= 0x41:
            raise EmulatorConfigError(f"security level {self.name}: its number must be odd, 1..0x41, got {self.number}")
        if not 0 < self.key_mask < 1 << (8 * self.seed_bytes):
            raise EmulatorConfigError(
                f"security level {self.name}: key_mask must fit {self.seed_bytes} bytes and not be 0"
            )
        if self.most_attempts < 1 or self.delay_s < 0.0:
            raise EmulatorConfigError(f"security level {self.name}: most_attempts must be >= 1 and delay_s >= 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceAccess:
    """Sessions and security levels of a service, and the conditions under which it changes something."""

    number: int
    name: str
    sessions: tuple[int, ...]
    levels: tuple[int, ...] = ()
    conditions: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class DataIdentifier:
    """A data identifier: live (its fields have sources) or stored (it has an initial value)."""

    number: int
    name: str
    fields: tuple[DatumField, ...]
    read: AccessRule
    initial: str | None = None  # text, or hexadecimal digits of all its bytes
    write: AccessRule | None = None

    def __post_init__(self) -> None:
        are_live = [bool(entry.source) for entry in self.fields]
        if not self.fields or any(are_live) != all(are_live) or all(are_live) != (self.initial is None):
            raise EmulatorConfigError(
                f"data {self.name}: either every field has a source, or there is an initial value"
            )
        if self.write is not None and self.initial is None:
            raise EmulatorConfigError(f"data {self.name}: what is live cannot be written")
        if self.initial is not None and len(self.initial_bytes) != self.size_bytes:
            raise EmulatorConfigError(
                f"data {self.name}: initial must have {self.size_bytes} bytes, got {self.initial!r}"
            )

    @property
    def size_bytes(self) -> int:
        """Length of its data [byte]."""
        return size_of(self.fields)

    @property
    def initial_bytes(self) -> bytes:
        """Initial bytes of a stored datum."""
        text = self.initial or ""
        try:
            return text.encode("ascii") if self.fields[0].kind is Coding.TEXT else bytes.fromhex(text)
        except ValueError as exc:
            raise EmulatorConfigError(
                f"data {self.name}: initial is neither ASCII text nor hexadecimal: {text!r}"
            ) from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class Routine:
    """A routine that ends by itself after its duration, or is ended by the vehicle before."""

    number: int
    name: str
    access: AccessRule
    duration_s: float
    ends_by_itself: bool = True
    is_awaited: bool = False  # whether the response to its start comes at its end
    can_be_stopped: bool = True
    task: Task = Task.NOTHING
    held_conditions: tuple[str, ...] = ()  # that must hold until an adaptation ends
    options: tuple[DatumField, ...] = ()
    results: tuple[DatumField, ...] = ()

    def __post_init__(self) -> None:
        if self.task is Task.REVS and (self.ends_by_itself or [entry.size_bytes for entry in self.options] != [1, 1]):
            raise EmulatorConfigError(
                f"routine {self.name}: task revs has two options of one byte, and the vehicle ends it, not the time"
            )
        if self.task in {Task.NEW_FLUID, Task.TOUCH_POINTS} and self.ends_by_itself:
            raise EmulatorConfigError(f"routine {self.name}: the vehicle ends task {self.task}, not the time")
        if self.held_conditions and self.task is not Task.TOUCH_POINTS:
            raise EmulatorConfigError(f"routine {self.name}: held_conditions belong to task touch_points")


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """A diagnostic trouble code and its failure type (ISO 15031-6, SAE J2012-DA)."""

    code: str  # P0811
    failure_type: int
    text: str
    severity: int
    lights_lamp: bool
    confirm_cycles: int = 1  # consecutive operation cycles with a failure
    heal_cycles: int = 3  # passed cycles until the lamp goes out
    age_cycles: int = 40  # passed warm-up cycles until the code is removed
    failed_step: int = 127  # of the fault detection counter
    passed_step: int = 128
    faults: tuple[Mapping[str, object], ...] = ()  # by the keys of a scenario's table: together they lead to this code

    def __post_init__(self) -> None:
        if not _CODE.fullmatch(self.code):
            raise EmulatorConfigError(
                f"trouble code {self.code} is none: in capitals, as P0741, its failure_type apart"
            )
        bytes_each = dict.fromkeys(("failure_type", "severity", "confirm_cycles", "heal_cycles", "age_cycles"), 255)
        for name, most in {**bytes_each, "failed_step": 127, "passed_step": 128}.items():
            value, least = getattr(self, name), 0 if name in {"failure_type", "severity"} else 1
            if not least <= value <= most:
                raise EmulatorConfigError(f"trouble code {self.code}: {name} must be {least}..{most}, got {value}")

    @property
    def number(self) -> int:
        """Its three bytes on the wire."""
        upper = _SYSTEMS.index(self.code[0]) << 14 | int(self.code[1:], 16)
        return upper << 8 | self.failure_type


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtendedRecord:
    """A record of extended data: counters of the trouble code, or values at the failure."""

    number: int
    name: str
    fields: tuple[DatumField, ...]

    def __post_init__(self) -> None:
        if not 0x01 <= self.number <= 0xEF:
            raise EmulatorConfigError(f"extended record {self.name}: its number must be 1..0xEF, got {self.number}")
        if len({entry.source.startswith(OF_MEMORY) for entry in self.fields}) != 1:
            raise EmulatorConfigError(
                f"extended record {self.name}: either all its fields are counters (memory.) or none is"
            )

    @property
    def has_counters(self) -> bool:
        """Whether it holds counters of the trouble code, not values at the failure."""
        return self.fields[0].source.startswith(OF_MEMORY)


def size_of(fields: Iterable[DatumField]) -> int:
    """Return the length of fields [byte]."""
    return sum(entry.size_bytes for entry in fields)


BLOCK: Final = 0x20  # numbers in one bitmap of supported ones
_LONGEST_PID: Final = 64  # bytes; those of J1979-DA have 41 at most
_LONGEST_INFO: Final = 0xFF


@dataclass(frozen=True, slots=True, kw_only=True)
class Pid:
    """A PID: its fields have sources, or it has a constant value."""

    number: int
    name: str
    fields: tuple[DatumField, ...]
    initial: str = ""  # hexadecimal digits of all its bytes
    is_frozen: bool = False  # part of the freeze frame

    def __post_init__(self) -> None:
        _check_number("PID", self.name, self.number)
        if not 1 <= size_of(self.fields) <= _LONGEST_PID:
            raise EmulatorConfigError(
                f"PID {self.name}: it must have 1..{_LONGEST_PID} bytes, got {size_of(self.fields)}"
            )
        if self.initial and len(_from_hex(self.name, self.initial)) != size_of(self.fields):
            raise EmulatorConfigError(
                f"PID {self.name}: initial must have {size_of(self.fields)} bytes, got {self.initial!r}"
            )

    @property
    def initial_bytes(self) -> bytes:
        """Its constant bytes, empty if it has sources."""
        return _from_hex(self.name, self.initial)


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleInfo:
    """A piece of service 09: a data identifier, a text, or hexadecimal digits."""

    number: int
    name: str
    size_bytes: int  # padded with zeros
    data: int | None = None
    text: str = ""
    digits: str = ""

    def __post_init__(self) -> None:
        _check_number("vehicle information", self.name, self.number)
        if sum((self.data is not None, bool(self.text), bool(self.digits))) != 1:
            raise EmulatorConfigError(f"vehicle information {self.name}: it has either data, a text or digits")
        if not 1 <= self.size_bytes <= _LONGEST_INFO:
            raise EmulatorConfigError(f"vehicle information {self.name}: size_bytes must be 1..{_LONGEST_INFO}")
        if len(self.fixed_bytes) > self.size_bytes:
            raise EmulatorConfigError(f"vehicle information {self.name}: it is longer than {self.size_bytes} bytes")

    @property
    def fixed_bytes(self) -> bytes:
        """Its constant bytes, empty if it is a data identifier."""
        try:
            return self.text.encode("ascii") or _from_hex(self.name, self.digits)
        except UnicodeEncodeError as exc:
            raise EmulatorConfigError(f"vehicle information {self.name}: text is not ASCII: {self.text!r}") from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorTest:
    """A monitor of service 06: its test is the fault detection counter of a trouble code."""

    number: int
    code: str  # P0811

    def __post_init__(self) -> None:
        _check_number("monitor", self.code, self.number)


@dataclass(frozen=True, slots=True, kw_only=True)
class Obd:
    """OBD as one controller speaks it."""

    clear_conditions: tuple[str, ...]  # conditions of service 04
    pids: Mapping[int, Pid]
    infos: Mapping[int, VehicleInfo]
    monitors: Mapping[int, MonitorTest]


def supported(numbers: Mapping[int, object], first: int) -> bytes | None:
    """Return the bitmap of supported numbers among the 32 after ``first``; None if there is no such bitmap.

    Its last bit says whether the next bitmap exists.
    """
    if first % BLOCK or (first and not any(number > first for number in numbers)):
        return None
    there = [number - first for number in numbers if first < number <= first + BLOCK and number % BLOCK]
    if any(number > first + BLOCK for number in numbers):
        there.append(BLOCK)
    return sum(1 << (BLOCK - place) for place in there).to_bytes(4, "big")


def _check_number(kind: str, name: str, number: int) -> None:
    if not 0x01 <= number <= 0xFF or number % BLOCK == 0:
        raise EmulatorConfigError(
            f"{kind} {name}: its number must be 1..0xFF and no multiple of 0x20, got 0x{number:02X}"
        )


def _from_hex(name: str, digits: str) -> bytes:
    try:
        return bytes.fromhex(digits)
    except ValueError as exc:
        raise EmulatorConfigError(f"{name}: not hexadecimal digits: {digits!r}") from exc


Value = float | str | bytes
Values = Mapping[str, Value]  # of the controller, by source; numbers in SI

_FORMATS: Final = {4: ">f", 8: ">d"}  # of IEEE 754, by bytes


def encode(fields: tuple[DatumField, ...], values: Values, *, keeps_code: bool = True) -> bytes:
    """Return the bytes of fields; a missing or invalid value becomes the code for not available.

    Without ``keeps_code`` that code is also the highest value, as in OBD.
    """
    return b"".join(_encoded(entry, values.get(entry.source), keeps_code=keeps_code) for entry in fields)


def not_available(entry: DatumField) -> int:
    """Return the code for not available: all bits set, or the most negative number if signed.

    Floats use NaN instead.
    """
    bits = 8 * entry.size_bytes
    return -(1 << (bits - 1)) if entry.kind is Coding.SIGNED else (1 << bits) - 1


def _encoded(entry: DatumField, value: Value | None, *, keeps_code: bool) -> bytes:
    if entry.kind is Coding.TEXT:
        return (
            str("" if value is None else value).encode("ascii", "replace")[: entry.size_bytes].ljust(entry.size_bytes)
        )
    if entry.kind is Coding.BYTES:
        raw = value if isinstance(value, bytes) else b""
        return raw[: entry.size_bytes].ljust(entry.size_bytes, b"\0")
    if entry.kind is Coding.FLOAT:
        return _float_bytes(entry, float(value) if isinstance(value, int | float) else math.nan)
    number = (
        _number(entry, float(value), keeps_code=keeps_code) if isinstance(value, int | float) else not_available(entry)
    )
    return number.to_bytes(entry.size_bytes, "big", signed=entry.kind is Coding.SIGNED)


def _float_bytes(entry: DatumField, value: float) -> bytes:
    """Return a number by IEEE 754; one that is too large for four bytes becomes infinite."""
    number = entry.conversion(value)
    try:
        return struct.pack(_FORMATS[entry.size_bytes], number)
    except OverflowError:
        return struct.pack(_FORMATS[entry.size_bytes], math.copysign(math.inf, number))


def _number(entry: DatumField, value: float, *, keeps_code: bool) -> int:
    """Return the nearest step of a value, limited to the range without the code for not available."""
    if math.isnan(value):
        return not_available(entry)
    bits = 8 * entry.size_bytes
    low, high = (
        (1 - (1 << (bits - 1)), (1 << (bits - 1)) - 1)
        if entry.kind is Coding.SIGNED
        else (0, (1 << bits) - 1 - keeps_code)
    )
    steps = (entry.conversion(value) - entry.offset) / entry.resolution
    return high if steps >= high else low if steps <= low else round(steps)


def _pieces(fields: tuple[DatumField, ...], raw: bytes) -> Iterator[tuple[DatumField, bytes]]:
    """Yield each field and its bytes."""
    place = 0
    for entry in fields:
        yield entry, raw[place : place + entry.size_bytes]
        place += entry.size_bytes


def decode_number(entry: DatumField, raw: bytes) -> float:
    if entry.kind is Coding.FLOAT:
        return float(struct.unpack(_FORMATS[entry.size_bytes], raw)[0])
    steps = int.from_bytes(raw, "big", signed=entry.kind is Coding.SIGNED)
    return steps * entry.resolution + entry.offset


def are_valid(fields: tuple[DatumField, ...], raw: bytes) -> bool:
    """Return whether bytes of the right length are valid for the fields."""
    return all(_is_valid(entry, piece) for entry, piece in _pieces(fields, raw))


def _is_valid(entry: DatumField, raw: bytes) -> bool:
    if entry.kind is Coding.BYTES:
        return not entry.pattern or re.fullmatch(entry.pattern, raw.hex()) is not None
    if entry.kind is Coding.TEXT:
        is_printable = all(0x20 <= byte < 0x7F for byte in raw)
        return is_printable and (not entry.pattern or re.fullmatch(entry.pattern, raw.decode("ascii")) is not None)
    return _is_within(entry, decode_number(entry, raw))


def holds(condition: Precondition, values: Values) -> bool:
    """Return whether a condition holds; not if its value is unknown."""
    value = values.get(condition.source)
    if not isinstance(value, int | float) or math.isnan(value):
        return False
    return _is_within(condition, value)


def _is_within(limits: DatumField | Precondition, value: float) -> bool:
    is_above = limits.minimum is None or value >= limits.minimum
    return is_above and (limits.maximum is None or value <= limits.maximum)
