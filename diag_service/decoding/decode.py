"""Signals compiled to tables, so that a few array operations decode a column; bit-identical to cantools."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from diag_service.columns import FloatArray, Int64Array, UInt8Array
from diag_service.decoding.bit_fields import BitField, PayloadWords, UInt64Array, place_signal
from diag_service.errors import ConfigError

__all__ = [
    "NOT_AVAILABLE",
    "BoolArray",
    "Decoded",
    "PayloadWords",
    "SignalTable",
    "compile_signal",
    "payload_words",
]

BoolArray = npt.NDArray[np.bool_]

MAX_FACTOR: Final = 1e100  # beyond any unit; keeps the arithmetic of wide integers finite
EXACT_INTEGER: Final = 2**53  # float64 holds every integer up to here
MAX_MULTIPLEX_DEPTH: Final = 8
FLOAT_TYPES: Final = {16: ("u2", "f2"), 32: ("u4", "f4"), 64: ("u8", "f8")}  # bits -> integer and float of that size
NOT_AVAILABLE: Final = re.compile(
    r"(?<![a-z])(n\s*/?\s*a|sna|snv|not[ _-]?av\w*|unavail\w*|not[ _-]?valid|invalid\w*|undefined|error\w*|fault\w*"
    r"|init\w*|fehler\w*|ung(ue|ü)ltig\w*|nicht[ _-]?verf(ue|ü)gbar\w*)(?![a-z])",
    re.IGNORECASE,
)
"""Texts in value tables that say a raw value is not a measurement."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """One decoded signal; where ``is_good`` is false the value means nothing."""

    value: FloatArray  # (n,) in the unit of the database
    is_good: BoolArray | None  # (n,); None: all are good
    invalid_count: int  # not available or out of range; a signal that its multiplexer leaves out is neither


@dataclass(frozen=True, slots=True)
class Selector:
    """A multiplexer and the values with which a signal is in the frame, as ranges that rise and do not touch."""

    field: BitField
    first: tuple[int, ...]
    last: tuple[int, ...]

    def is_present(self, words: PayloadWords) -> BoolArray:
        """Return in which frames the signal is, shape (n,)."""
        raw = self.field.raw(words)
        if self.first == self.last and len(self.first) == 1:
            is_present: BoolArray = raw == raw.dtype.type(self.first[0])
            return is_present
        first, last = np.array(self.first, raw.dtype), np.array(self.last, raw.dtype)
        place = np.searchsorted(first, raw, side="right") - 1  # -1: below all ranges
        return (place >= 0) & (raw <= last[place])


@dataclass(frozen=True, slots=True)
class IntegerCode:
    """Raw integers to physical values, with the raw values that are none."""

    scale: int | float
    offset: int | float
    raw_range: tuple[int, int]  # what the database calls valid
    raw_limits: tuple[int, int]  # what fits the bits
    not_available: tuple[int, ...]  # inside ``raw_range``

    def value(self, raw: UInt64Array | Int64Array) -> FloatArray:
        """Return physical values in the very operations that cantools uses, shape (n,)."""
        if self.scale == 1 and self.offset == 0:
            return raw.astype(np.float64)
        if isinstance(self.scale, float) or self._has_exact_products():
            return raw.astype(np.float64) * float(self.scale) + float(self.offset)
        return np.array([value * self.scale + self.offset for value in raw.tolist()], np.float64)

    @property
    def is_exact_in_float(self) -> bool:
        """Whether float64 holds every raw value, and the arithmetic is that of floats or cannot be told from it."""
        is_float = isinstance(self.scale, float) or (self.scale == 1 and self.offset == 0)
        return self._widest <= EXACT_INTEGER and (is_float or self._has_exact_products())

    @property
    def _widest(self) -> int:
        return max(abs(limit) for limit in self.raw_limits)

    def _has_exact_products(self) -> bool:
        """Whether float64 holds every product and sum of integers that can occur."""
        return self._widest <= EXACT_INTEGER and self._widest * abs(self.scale) + abs(self.offset) <= EXACT_INTEGER

    def is_valid(self, raw: UInt64Array | Int64Array) -> BoolArray | None:
        """Return which raw values are measurements, shape (n,); None: all can be."""
        valid: BoolArray | None = None
        kind = raw.dtype.type
        if self.raw_range[0] > self.raw_limits[0]:
            valid = raw >= kind(self.raw_range[0])
        if self.raw_range[1] < self.raw_limits[1]:
            below = raw <= kind(self.raw_range[1])
            valid = below if valid is None else valid & below
        for code in self.not_available:
            differs = raw != kind(code)
            valid = differs if valid is None else valid & differs
        return valid


@dataclass(frozen=True, slots=True)
class FloatCode:
    """Raw IEEE floats to physical values."""

    length: int
    scale: int | float
    offset: int | float
    value_range: tuple[float, float]

    def value(self, bits: UInt64Array) -> FloatArray:
        """Return physical values, shape (n,)."""
        unsigned, floating = FLOAT_TYPES[self.length]
        with np.errstate(over="ignore", invalid="ignore"):
            value: FloatArray = bits.astype(unsigned).view(floating).astype(np.float64)
            return value if self.scale == 1 and self.offset == 0 else value * float(self.scale) + float(self.offset)

    def is_valid(self, value: FloatArray) -> BoolArray:
        """Return which values are finite and in range, shape (n,)."""
        return np.isfinite(value) & (value >= self.value_range[0]) & (value <= self.value_range[1])


@dataclass(frozen=True, slots=True)
class SignalTable:
    """A signal, compiled."""

    field: BitField
    code: IntegerCode | FloatCode
    selectors: tuple[Selector, ...]

    def decode(self, words: PayloadWords) -> Decoded:
        """Return the signal in every payload."""
        raw = self.field.raw(words)
        if isinstance(self.code, FloatCode):
            value = self.code.value(raw.view(np.uint64))
            valid: BoolArray | None = self.code.is_valid(value)
        else:
            value = self.code.value(raw)
            valid = self.code.is_valid(raw)
        if self.selectors:
            present = self.presence(words)
            good = present if valid is None else present & valid
            return Decoded(value, good, int(np.count_nonzero(present & ~good)))
        if valid is None or valid.all():
            return Decoded(value, None, 0)
        return Decoded(value, valid, int(np.count_nonzero(~valid)))

    def presence(self, words: PayloadWords) -> BoolArray:
        """Return which frames carry the signal, as its multiplexers say, shape (n,)."""
        if not self.selectors:
            return np.ones(len(words), np.bool_)
        present = self.selectors[0].is_present(words)
        for selector in self.selectors[1:]:
            present &= selector.is_present(words)
        return present


def payload_words(data: UInt8Array, rows: Int64Array | None = None) -> PayloadWords:
    """Return payloads, shape (n, 8) or (n, 64), as words: some rows of them, or all."""
    return PayloadWords(data, rows)


def compile_signal(message: Message, name: str, *, check_range: bool = True) -> SignalTable:
    """Return the table of one signal.

    Parameters
    ----------
    message : Message
        Message as cantools parsed it.
    name : str
        Name of a signal of the message.
    check_range : bool
        Whether values outside the signal's [min|max] are invalid; some databases have junk there.

    Raises
    ------
    ConfigError
        If the signal cannot be decoded: outside its message or the 64 bytes of a frame, of a width that its type
        does not have, or multiplexed by something that is no multiplexer.
    """
    signal = message.get_signal_by_name(name)
    where = f"{message.name}.{name}"
    field = place_signal(message, signal)
    factors = (signal.scale, signal.offset)
    if signal.scale == 0 or not all(abs(factor) <= MAX_FACTOR for factor in factors):
        raise ConfigError(f"{where}: scale {signal.scale} and offset {signal.offset} are not usable")
    code = _float_code(signal, where, check_range=check_range) if signal.conversion.is_float else None
    return SignalTable(
        field=field,
        code=code or _integer_code(signal, field, check_range=check_range),
        selectors=_selectors(message, signal, where),
    )


def _integer_code(signal: Signal, field: BitField, *, check_range: bool) -> IntegerCode:
    """Compile scaling and validity of an integer signal."""
    scale, offset = signal.scale, signal.offset
    if float(scale).is_integer() and float(offset).is_integer():
        scale, offset = int(scale), int(offset)
    raw_limits = field.raw_limits
    raw_range = _raw_range(signal, raw_limits) if check_range else raw_limits
    codes = [code for code, text in signal.choices.items() if NOT_AVAILABLE.search(str(text))] if signal.choices else []
    return IntegerCode(
        scale=scale,
        offset=offset,
        raw_range=raw_range,
        raw_limits=raw_limits,
        not_available=tuple(code for code in sorted(codes) if raw_range[0] <= code <= raw_range[1]),
    )


def _raw_range(signal: Signal, raw_limits: tuple[int, int]) -> tuple[int, int]:
    """Return the raw values inside [min|max], to the nearest step; an empty range is no range."""
    lowest, highest = raw_limits
    minimum, maximum = _physical_range(signal)
    ends = sorted((limit - signal.offset) / signal.scale for limit in (minimum, maximum))
    low = max(lowest, math.ceil(ends[0] - 0.5)) if math.isfinite(ends[0]) else lowest
    high = min(highest, math.floor(ends[1] + 0.5)) if math.isfinite(ends[1]) else highest
    return (low, high) if low <= high else raw_limits


def _physical_range(signal: Signal) -> tuple[float, float]:
    """Return [min|max] of a signal; infinite where the database says nothing."""
    minimum = _bound(signal.minimum, -math.inf)
    maximum = _bound(signal.maximum, math.inf)
    return (minimum, maximum) if minimum < maximum else (-math.inf, math.inf)


def _bound(bound: float | None, unbounded: float) -> float:
    """Return one end of a range; the database may write integers that no float holds."""
    return float(bound) if bound is not None and abs(bound) <= MAX_FACTOR else unbounded


def _float_code(signal: Signal, where: str, *, check_range: bool) -> FloatCode:
    """Compile scaling and validity of a float signal."""
    if signal.length not in FLOAT_TYPES:
        raise ConfigError(f"{where}: no float has {signal.length} bits")
    value_range = _physical_range(signal) if check_range else (-math.inf, math.inf)
    return FloatCode(signal.length, signal.scale, signal.offset, value_range)


def _selectors(message: Message, signal: Signal, where: str) -> tuple[Selector, ...]:
    """Return the multiplexers that decide whether a signal is in a frame, innermost first."""
    selectors: list[Selector] = []
    while signal.multiplexer_ids is not None:
        multiplexer = {s.name: s for s in message.signals if s.is_multiplexer}.get(signal.multiplexer_signal or "")
        if multiplexer is None or len(selectors) == MAX_MULTIPLEX_DEPTH:
            raise ConfigError(f"{where} is multiplexed, but its message has no proper multiplexer for it")
        selectors.append(_selector(place_signal(message, multiplexer), signal.multiplexer_ids))
        signal = multiplexer
    return tuple(selectors)


def _selector(field: BitField, values: Iterable[int]) -> Selector:
    """Return the selector of some values of a multiplexer, those aside that do not fit its bits."""
    low, high = field.raw_limits
    fitting = sorted({value for value in values if low <= value <= high})
    if not fitting:
        return Selector(field, (high,), (low,))  # an empty range: in no frame
    first, last = [fitting[0]], []
    for before, value in pairwise(fitting):
        if value - before > 1:
            last.append(before)
            first.append(value)
    return Selector(field, tuple(first), (*last, fitting[-1]))
