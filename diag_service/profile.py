"""Profiles: in which message and signal of a database each canonical signal is found, and in which unit."""

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from clutch_model.units import k_from_degc, m_s_from_km_h, pa_from_bar, rad_s_from_rpm
from diag_service.errors import ConfigError
from diag_service.records import BALANCE_SIGNALS, FloatArray, Signal

MAX_NUMBER: Final = 0xFF  # of a channel or a J1939 source address
PROTOCOLS: Final = {"can": False, "j1939": True}
PROFILE_KEYS: Final = frozenset({"name", "signals", "protocol", "channel"})

Conversion = Callable[[FloatArray], FloatArray]

PROFILE_PATH: Final = Path(__file__).parent / "profiles" / "dct.toml"

MANDATORY: Final = frozenset({*BALANCE_SIGNALS, Signal.CURRENT_GEAR, Signal.TARGET_GEAR, Signal.SUMP_TEMPERATURE})
"""Without these there is no friction to estimate."""


def _same(value: FloatArray) -> FloatArray:
    """Return the value: it has its SI unit already."""
    return value


_TO_SI: Final[Mapping[str, Mapping[str, Conversion]]] = {
    "rad_s": {
        **dict.fromkeys(("rpm", "1/min", "min-1", "r/min", "rev/min", "u/min", "unit_minutinver"), rad_s_from_rpm),
        "rad/s": _same,
    },
    "m_s": {
        **dict.fromkeys(("km/h", "kmh", "kph", "kmph", "unit_kilometerperhour"), m_s_from_km_h),
        "m/s": _same,
    },
    "pa": {
        **dict.fromkeys(("bar", "unit_bar"), pa_from_bar),
        **dict.fromkeys(("mbar", "hpa", "unit_millibar"), lambda pressure_hpa: pressure_hpa * 100.0),
        "kpa": lambda pressure_kpa: pressure_kpa * 1e3,
        "pa": _same,
    },
    "nm": dict.fromkeys(("nm", "n.m", "n·m", "n*m", "unit_newtometer"), _same),
    "ratio": {
        **dict.fromkeys(("%", "percent", "unit_percent"), lambda percent: percent / 100.0),
        "": _same,
    },
    "k": {
        **dict.fromkeys(("degc", "°c", "c", "celsius", "unit_degrecelsi"), k_from_degc),
        "k": _same,
    },
    "m": {
        **dict.fromkeys(("km", "unit_kilometer"), lambda distance_km: distance_km * 1e3),
        **dict.fromkeys(("m", "unit_meter"), _same),
    },
}
"""Spellings of units, without blanks and in lower case, by the unit that ends a canonical signal's name."""

_KINDS: Final = ("rad_s", "m_s", "ratio", "nm", "pa", "k", "m")  # longest first


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSource:
    """Where one canonical signal comes from: ``SI(scale * decoded + offset)``."""

    message: str
    signal: str
    unit: str | None = None  # None: as the database says
    scale: float = 1.0
    offset: float = 0.0  # in the unit of the database
    check_range: bool = True  # whether values outside the database's [min|max] are invalid
    source_address: int | None = None  # of a J1939 message; None: the first sender that is heard

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and math.isfinite(self.offset)) or self.scale == 0.0:
            raise ConfigError(f"scale {self.scale} and offset {self.offset} are not usable")
        if self.source_address is not None and not 0 <= self.source_address <= MAX_NUMBER:
            raise ConfigError(f"source_address {self.source_address} is not one of J1939")


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """A named set of sources."""

    name: str
    sources: Mapping[Signal, SignalSource]
    is_j1939: bool = False  # 29-bit identifiers are matched by their parameter group, whatever the database says
    channel: int | None = None  # bus of a log with several; None: the first on which a message is heard


def load_profile(path: Path = PROFILE_PATH) -> Profile:
    """Return a profile from its TOML file.

    Raises
    ------
    ConfigError
        If the file is unreadable or not TOML, or with all the entries that are wrong: unknown canonical signals,
        unknown or missing keys, values of the wrong type.
    """
    table = _read_table(path)
    signals = table.get("signals")
    if not isinstance(signals, dict) or table.keys() - PROFILE_KEYS:
        raise ConfigError(
            f"profile {path} must have a table [signals] and, besides, at most name, protocol and channel"
        )
    sources: dict[Signal, SignalSource] = {}
    problems: list[str] = []
    for key, entry in signals.items():
        try:
            sources[_canonical(key)] = _source(entry)
        except ConfigError as error:
            problems.append(f"{key}: {error}")
    channel = table.get("channel")
    if channel is not None and not (type(channel) is int and 0 <= channel <= MAX_NUMBER):
        problems.append(f"channel must be a number up to {MAX_NUMBER}")
    protocol = table.get("protocol", "can")
    if not isinstance(protocol, str) or protocol not in PROTOCOLS:
        problems.append(f"protocol must be one of {', '.join(PROTOCOLS)}")
    if problems:
        raise ConfigError(f"profile {path}: {'; '.join(problems)}")
    return Profile(
        name=str(table.get("name", path.stem)),
        sources=MappingProxyType(sources),
        is_j1939=PROTOCOLS[str(protocol)],
        channel=channel if isinstance(channel, int) else None,
    )


def to_si(signal: Signal, source: SignalSource, database_unit: str | None) -> Conversion:
    """Return the conversion of decoded values to the SI unit of a canonical signal.

    Raises
    ------
    ConfigError
        If the unit is unknown or of another kind than the signal.
    """
    kind = next((kind for kind in _KINDS if signal.value.endswith(f"_{kind}")), None)
    unit = source.unit if source.unit is not None else database_unit or ""
    convert = _same if kind is None else _TO_SI[kind].get("".join(unit.split()).lower())
    if convert is None:
        raise ConfigError(f"the unit {unit!r} of {source.message}.{source.signal} is not one of {signal.value}")
    if source.scale == 1.0 and source.offset == 0.0:
        return convert
    return lambda decoded: convert(decoded * source.scale + source.offset)


def _read_table(path: Path) -> dict[str, object]:
    """Return the TOML file as a table."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the profile {path}: {error.strerror or error}") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"the profile {path} is not TOML: {error}") from error


def _canonical(key: str) -> Signal:
    """Return the canonical signal of a key."""
    try:
        return Signal(key)
    except ValueError as error:
        raise ConfigError("not a canonical signal") from error


_FIELD_TYPES: Final[Mapping[str, type | tuple[type, ...]]] = {
    "message": str,
    "signal": str,
    "unit": str,
    "scale": (int, float),
    "offset": (int, float),
    "check_range": bool,
    "source_address": int,
}


def _source(entry: object) -> SignalSource:
    """Return one checked entry of a profile."""
    if not isinstance(entry, dict):
        raise ConfigError("must be a table with message and signal")
    for key, value in entry.items():
        expected = _FIELD_TYPES.get(key)
        if expected is None:
            raise ConfigError(f"unknown key {key}")
        if not isinstance(value, expected) or (isinstance(value, bool) and expected is not bool):
            raise ConfigError(f"{key} has the wrong type")
    if missing := {"message", "signal"} - entry.keys():
        raise ConfigError(f"lacks {' and '.join(sorted(missing))}")
    return SignalSource(**entry)
