"""Profiles: in which message and signal of a database each canonical signal is found, and in which unit."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from canlog.database.signal_columns import SignalColumn
from canlog.errors import DefinitionError
from clutch_model.calibration import TorqueSource
from clutch_model.tables import read_table, record_from
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.errors import ConfigError
from diag_service.mapping.asked_signals import (
    LARGEST_ID,
    READ_DATA,
    READ_LOCAL,
    READ_PID,
    AskedField,
    sizes_of,
    usual_reply_id,
)
from diag_service.mapping.units import SAME, Conversion, conversion, kind_of_unit

MAX_NUMBER: Final = 0xFF  # of a channel or a J1939 source address
PROTOCOLS: Final = {"can": False, "j1939": True}
PROFILE_KEYS: Final = frozenset({"name", "signals", "protocol", "channel", "database", "gears", "asking"})
MOST_TOGETHER: Final = 64  # identifiers in one request


PROFILE_FOLDER: Final = Path(__file__).parents[1] / "profiles"
PROFILE_PATH: Final = PROFILE_FOLDER / "dct.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSource(ABC):
    """How one canonical signal is read, wherever it comes from: ``SI(scale * decoded + offset)``."""

    unit: str | None = None  # None: as the database says
    scale: float = 1.0
    offset: float = 0.0  # in the unit of the database
    check_range: bool = True  # whether values outside the database's [min|max] are invalid
    check_codes: bool = True  # whether codes that say "not available" by their place in the scale are invalid
    valid: tuple[float, float] | None = None  # decoded values outside are invalid
    invalid: tuple[float, ...] = ()  # decoded values that are codes
    values: tuple[float, ...] = ()  # what the decoded numbers 0, 1, 2, ... stand for, such as gears; others are invalid
    optional: bool = False  # a database without it serves as well
    origin: TorqueSource = TorqueSource.MEASURED  # of engine torque: what else goes with it

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and math.isfinite(self.offset)) or self.scale == 0.0:
            raise ConfigError(f"scale {self.scale} and offset {self.offset} are not usable")
        if self.valid is not None and not self.valid[0] < self.valid[1]:
            raise ConfigError(f"valid {list(self.valid)} is no range")
        if not all(math.isfinite(value) for value in (*(self.valid or ()), *self.invalid, *self.values)):
            raise ConfigError("valid, invalid and values must be finite")

    @property
    @abstractmethod
    def place(self) -> str:
        """Where it is found, for people."""

    @property
    def message_name(self) -> str:
        """The name of its message: of what is no signal of a bus its own."""
        return self.place

    @property
    def signal_name(self) -> str:
        """The name of its signal, likewise."""
        return self.place


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSource(SignalSource):
    """A signal of a message: ``SI(scale * (decoded - less) * times + offset)``.

    The message is named, or by its J1939 parameter group; the signal is named, or by its J1939 parameter number.
    """

    message: str = ""
    pgn: int | None = None
    signal: str = ""
    spn: int | None = None
    less: str | None = None  # signal of the same message that is subtracted
    times: str | None = None  # signal of the same message that multiplies, such as a reference torque
    source_address: int | None = None  # of a J1939 message; None: the first sender that is heard
    request: bool = False  # a J1939 group that is asked for (PGN 59904), whether it comes by itself or not

    def __post_init__(self) -> None:
        SignalSource.__post_init__(self)
        if self.request and self.pgn is None:
            raise ConfigError("request needs pgn")
        if bool(self.message) is (self.pgn is not None):
            raise ConfigError("lacks message, or has it beside pgn" if self.message else "lacks message")
        if bool(self.signal) is (self.spn is not None):
            raise ConfigError("lacks signal, or has it beside spn" if self.signal else "lacks signal")
        if self.source_address is not None and not 0 <= self.source_address <= MAX_NUMBER:
            raise ConfigError(f"source_address {self.source_address} is not one of J1939")

    @property
    def message_name(self) -> str:
        return self.message

    @property
    def signal_name(self) -> str:
        return self.signal

    @property
    def place(self) -> str:
        message = self.message or f"PGN {self.pgn}"
        return f"{message}.{self.signal}" if self.signal else f"{message} SPN {self.spn}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSource(SignalSource):
    """A column of a table of signals."""

    column: str
    or_unit: str | None = None  # another unit that something speaks for: whoever knows the vehicle decides

    @property
    def place(self) -> str:
        return self.column


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedSource(SignalSource):
    """A part of a datum that a controller tells whoever asks."""

    did: int | None = None  # by service 22
    pid: int | None = None  # by service 01 of OBD
    local: int | None = None  # by service 21 of KWP2000
    at: str = ""  # identifier of requests, hexadecimal
    reply: str = ""  # of answers; empty: as the standard has it
    byte: int = 0  # first byte of the value within the datum
    bit: int = 0  # its lowest bit
    length: int = 16  # [bit]
    order: str = "big"
    signed: bool = False
    size: int = 0  # of the whole datum [byte]; 0: up to the end of its last value

    def __post_init__(self) -> None:
        SignalSource.__post_init__(self)
        if sum(number is not None for number in (self.did, self.pid, self.local)) != 1:
            raise ConfigError("has more than one of did, pid, local")
        if self.order not in {"big", "little"}:
            raise ConfigError(f"order must be big or little, got {self.order!r}")
        if not self.at:
            raise ConfigError('lacks at: the identifier of requests, such as "7E1"')
        _ = self.asked

    @property
    def asked(self) -> AskedField:
        """What is asked for; raises ConfigError."""
        request_id = _identifier(self.at, "at")
        service, number = next(
            (service, number)
            for service, number in ((READ_DATA, self.did), (READ_PID, self.pid), (READ_LOCAL, self.local))
            if number is not None
        )
        return AskedField(
            request_id=request_id,
            reply_id=_identifier(self.reply, "reply") if self.reply else usual_reply_id(request_id),
            service=service,
            number=number,
            byte=self.byte,
            bit=self.bit,
            length=self.length,
            is_little=self.order == "little",
            is_signed=self.signed,
            size=self.size,
        )

    @property
    def message_name(self) -> str:
        return self.asked.name

    @property
    def signal_name(self) -> str:
        return self.asked.name

    @property
    def place(self) -> str:
        return str(self.asked.data_id)


_OF_BUS: Final = frozenset({"message", "signal", "pgn", "spn", "request", "less", "times"})
_OF_ASKED: Final = frozenset({"did", "pid", "local"})


def source_from(entry: object) -> SignalSource:
    """Return the source that an entry of a profile describes, of the kind that its keys name; raises ConfigError."""
    keys = entry.keys() if isinstance(entry, Mapping) else frozenset[str]()
    if keys & _OF_ASKED:
        if beside := sorted(keys & {*_OF_BUS, "column"}):
            raise ConfigError(f"is asked for, and has a message, signal or column beside: {', '.join(beside)}")
        return record_from(AskedSource, entry, error=ConfigError)
    if keys & {"at", "reply"}:
        raise ConfigError("at and reply need did, pid or local")
    if "column" not in keys:
        return record_from(BusSource, entry, error=ConfigError)
    if keys & _OF_BUS:
        raise ConfigError("has a column of a table beside a message or signal of a bus")
    return record_from(ColumnSource, entry, error=ConfigError)


def _identifier(text: str, what: str) -> int:
    try:
        can_id = int(text, 16)
    except ValueError:
        can_id = -1
    if not 0 < can_id <= LARGEST_ID:
        raise ConfigError(f"{what} must be hexadecimal, 1 to {LARGEST_ID:X}, got {text!r}")
    return can_id


@dataclass(frozen=True, slots=True, kw_only=True)
class AskingRules:
    """What the controllers of a profile allow whoever asks them."""

    together: int = 1  # identifiers in one request of service 22
    define: bool = False  # what is asked for in every round is made one datum first, by service 2C

    def __post_init__(self) -> None:
        if not 1 <= self.together <= MOST_TOGETHER:
            raise ConfigError(f"together must be 1 to {MOST_TOGETHER}, got {self.together}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """A named set of sources."""

    name: str
    sources: Mapping[Signal, SignalSource]
    gears: GearRatios | None = None  # where no signal tells the gear
    database: Path | None = None  # the database that ships with the profile
    is_lenient: bool = False  # a shipped profile serves many databases: what one lacks is left out
    is_j1939: bool = False  # 29-bit identifiers are matched by their parameter group, whatever the database says
    channel: int | None = None  # bus of a log with several; None: the first on which a message is heard
    asking: AskingRules = AskingRules()

    @property
    def columns(self) -> tuple[SignalColumn, ...]:
        """The columns of a table of signals that it names, and what is asked for."""
        columns = [source for source in self.sources.values() if not isinstance(source, BusSource)]
        return tuple(SignalColumn(source.message_name, source.unit or "") for source in columns)

    @property
    def torque(self) -> TorqueSource:
        """Where the engine's torque comes from."""
        source = self.sources.get(Signal.ENGINE_TORQUE)
        return TorqueSource.UNKNOWN if source is None else source.origin

    @property
    def asked(self) -> Mapping[Signal, AskedField]:
        """What a controller tells whoever asks."""
        return {signal: source.asked for signal, source in self.sources.items() if isinstance(source, AskedSource)}

    @property
    def groups(self) -> Mapping[Signal, int]:
        """The J1939 groups that are asked for: their answers are read as whatever is broadcast."""
        of_bus = {signal: source for signal, source in self.sources.items() if isinstance(source, BusSource)}
        return {signal: source.pgn for signal, source in of_bus.items() if source.request and source.pgn is not None}

    @property
    def is_table(self) -> bool:
        """Whether it reads a table of signals and no frames."""
        return bool(self.sources) and all(isinstance(source, ColumnSource) for source in self.sources.values())

    @property
    def is_of_columns(self) -> bool:
        """Whether it needs no database: what is a signal of a message may be absent."""
        is_needed = (isinstance(source, BusSource) and not source.optional for source in self.sources.values())
        return bool(self.columns) and not any(is_needed)


def shipped_profiles() -> tuple[str, ...]:
    """Return the names of the profiles that ship with the service."""
    return tuple(sorted(path.stem for path in PROFILE_FOLDER.glob("*.toml")))


def find_profile(name: Path | Profile) -> Profile:
    """Return a profile by its path, or by the name of one that ships with the service; one that is found as it is.

    Raises ConfigError if there is no such profile, or it is unusable.
    """
    if isinstance(name, Profile):
        return name
    if len(name.parts) == 1 and name.name in shipped_profiles() and not name.exists():
        return load_shipped(name.name)
    if len(name.parts) == 1 and not name.suffix and not name.exists():
        raise ConfigError(f"no profile {name}: give a TOML file or one of {', '.join(shipped_profiles())}")
    return load_profile(name)


def load_shipped(name: str) -> Profile:
    profile = load_profile(PROFILE_FOLDER / f"{name}.toml")
    return replace(profile, is_lenient=True)


def load_profile(path: Path = PROFILE_PATH) -> Profile:
    """Return a profile from its TOML file.

    Raises ConfigError if the file is unreadable or not TOML, or with all the entries that are wrong: unknown canonical
    signals, unknown or missing keys, values of the wrong type.
    """
    return profile_of(read_table(path, "the profile", ConfigError), path)


def profile_of(table: Mapping[str, Any], path: Path) -> Profile:
    """Return a profile from the table of a TOML file; raises as `load_profile`, naming the file."""
    signals = table.get("signals")
    if not isinstance(signals, dict) or table.keys() - PROFILE_KEYS:
        raise ConfigError(
            f"profile {path} must have a table [signals] and, besides, at most name, protocol, channel, database, "
            "gears, asking"
        )
    sources: dict[Signal, SignalSource] = {}
    problems: list[str] = []
    for key, entry in signals.items():
        try:
            sources[_canonical(key)] = source = source_from(entry)
            if source.origin is not TorqueSource.MEASURED and key != Signal.ENGINE_TORQUE.value:
                problems.append(f"{key}: origin says where engine torque comes from, nothing else")
        except ConfigError as error:
            problems.append(f"{key}: {error}")
    gears, asking = None, AskingRules()
    try:
        gears = gear_ratios(table.get("gears"))
        asking = record_from(AskingRules, table.get("asking", {}), "asking.", error=ConfigError)
        sizes_of(source.asked for source in sources.values() if isinstance(source, AskedSource))
    except (ConfigError, DefinitionError) as error:
        problems.append(str(error))
    channel = table.get("channel")
    if channel is not None and not (type(channel) is int and 0 <= channel <= MAX_NUMBER):
        problems.append(f"channel must be a number up to {MAX_NUMBER}")
    protocol = table.get("protocol", "can")
    if not isinstance(protocol, str) or protocol not in PROTOCOLS:
        problems.append(f"protocol must be one of {', '.join(PROTOCOLS)}")
    if len({isinstance(source, ColumnSource) for source in sources.values()}) > 1:
        problems.append("some sources are columns of a table, others signals of a bus")
    if problems:
        raise ConfigError(f"profile {path}: {'; '.join(problems)}")
    return Profile(
        name=str(table.get("name", path.stem)),
        sources=MappingProxyType(sources),
        gears=gears,
        database=path.parent / str(table["database"]) if "database" in table else None,
        is_j1939=PROTOCOLS[str(protocol)],
        channel=channel if isinstance(channel, int) else None,
        asking=asking,
    )


def to_si(signal: Signal, source: SignalSource, database_unit: str | None) -> Conversion:
    """Return the conversion of decoded values to the SI unit of a canonical signal.

    Raises ConfigError if the unit is unknown or of another kind than the signal.
    """
    kind = kind_of_unit(signal)
    unit = source.unit if source.unit is not None else database_unit or ""
    convert = SAME if kind is None else conversion(kind, unit)
    if convert is None:
        raise ConfigError(f"the unit {unit!r} of {source.place} is not one of {signal.value}")
    return convert.after(source.scale, source.offset)


def _canonical(key: str) -> Signal:
    try:
        return Signal(key)
    except ValueError as error:
        raise ConfigError("not a canonical signal") from error


def gear_ratios(entry: object, error: type[Exception] = ConfigError) -> GearRatios | None:
    """Return the checked table of ratios, if there is one; raises ``error``."""
    if entry is None:
        return None
    gears = record_from(GearRatios, entry, "gears.", error=error)
    if gears.over not in {Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED}:
        raise error(f"gears: over must be {Signal.OUTPUT_SPEED.value} or {Signal.VEHICLE_SPEED.value}")
    ratios = gears.ratios
    if not all(math.isfinite(ratio) for ratio in ratios):
        raise error("gears: ratios must be finite")
    if len(ratios) < 2 or any(high <= low for high, low in pairwise(ratios)) or ratios[-1] <= 0.0:
        raise error("gears: ratios must fall from gear to gear and stay above 0")
    return gears
