"""What a table says of OBD (SAE J1979, ISO 15031-5): which of its two profiles is spoken, PIDs, vehicle information."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from ecu_emulator.diagnostics.descriptions import OF_MEMORY, ExtendedRecord, Field, Kind, size_of
from ecu_emulator.errors import ConfigError

BLOCK: Final = 0x20  # so many numbers does one bitmap of supported ones cover
_LONGEST_PID: Final = 64  # bytes; those of J1979-DA have 41 at most
_LONGEST_INFO: Final = 0xFF
IN_USE: Final = ExtendedRecord(
    number=0x91,
    name="in-use performance",
    fields=(
        Field(name="completions", kind=Kind.UNSIGNED, size_bytes=2, source=f"{OF_MEMORY}ran_cycles"),
        Field(name="conditions encountered", kind=Kind.UNSIGNED, size_bytes=2, source=f"{OF_MEMORY}driven_cycles"),
    ),
)
"""Extended data of SAE J1979-2: in how many operation cycles a test has run, and in how many it should have."""


class Profile(StrEnum):
    """How OBD is spoken: by services 01 to 0A (SAE J1979), or by those of UDS (SAE J1979-2)."""

    CLASSIC = "classic"
    UDS = "uds"


@dataclass(frozen=True, slots=True, kw_only=True)
class Pid:
    """A parameter: its fields have sources, or it has an initial value and never another one."""

    number: int
    name: str
    fields: tuple[Field, ...]
    initial: str = ""  # hexadecimal digits of all its bytes
    is_frozen: bool = False  # kept in the freeze frame

    def __post_init__(self) -> None:
        _check_number("PID", self.name, self.number)
        if not 1 <= size_of(self.fields) <= _LONGEST_PID:
            raise ConfigError(f"PID {self.name}: it must have 1..{_LONGEST_PID} bytes, got {size_of(self.fields)}")
        if self.initial and len(_from_hex(self.name, self.initial)) != size_of(self.fields):
            raise ConfigError(f"PID {self.name}: initial must have {size_of(self.fields)} bytes, got {self.initial!r}")

    @property
    def initial_bytes(self) -> bytes:
        """What it always is, empty if it has sources."""
        return _from_hex(self.name, self.initial)


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleInfo:
    """A piece of service 09: what a data identifier holds, a text, or hexadecimal digits."""

    number: int
    name: str
    size_bytes: int  # filled up with zeros
    data: int | None = None
    text: str = ""
    digits: str = ""

    def __post_init__(self) -> None:
        _check_number("vehicle information", self.name, self.number)
        if sum((self.data is not None, bool(self.text), bool(self.digits))) != 1:
            raise ConfigError(f"vehicle information {self.name}: it has either data, a text or digits")
        if not 1 <= self.size_bytes <= _LONGEST_INFO:
            raise ConfigError(f"vehicle information {self.name}: size_bytes must be 1..{_LONGEST_INFO}")
        if len(self.fixed_bytes) > self.size_bytes:
            raise ConfigError(f"vehicle information {self.name}: it is longer than {self.size_bytes} bytes")

    @property
    def fixed_bytes(self) -> bytes:
        """What it always is, empty if it is a data identifier's."""
        try:
            return self.text.encode("ascii") or _from_hex(self.name, self.digits)
        except UnicodeEncodeError as exc:
            raise ConfigError(f"vehicle information {self.name}: text is not ASCII: {self.text!r}") from exc


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

    profile: Profile
    clear_conditions: tuple[str, ...]  # of the vehicle, before codes are cleared by service 04
    pids: Mapping[int, Pid]
    infos: Mapping[int, VehicleInfo]
    monitors: Mapping[int, MonitorTest]
    readiness_group: int = 0x03  # SAE J1979-2: comprehensive components


def supported(numbers: Mapping[int, object], first: int) -> bytes | None:
    """Return the bitmap of what is there of the 32 numbers after ``first``; None if it has nothing to say.

    Its last bit says that the next bitmap is there.
    """
    if first % BLOCK or (first and not any(number > first for number in numbers)):
        return None
    there = [number - first for number in numbers if first < number <= first + BLOCK and number % BLOCK]
    if any(number > first + BLOCK for number in numbers):
        there.append(BLOCK)
    return sum(1 << (BLOCK - place) for place in there).to_bytes(4, "big")


def _check_number(kind: str, name: str, number: int) -> None:
    if not 0x01 <= number <= 0xFF or number % BLOCK == 0:
        raise ConfigError(f"{kind} {name}: its number must be 1..0xFF and no multiple of 0x20, got 0x{number:02X}")


def _from_hex(name: str, digits: str) -> bytes:
    try:
        return bytes.fromhex(digits)
    except ValueError as exc:
        raise ConfigError(f"{name}: not hexadecimal digits: {digits!r}") from exc
