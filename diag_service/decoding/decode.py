"""Signals compiled to tables, so that a few array operations decode a column; bit-identical to cantools."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from diag_service.columns import FloatArray, Int64Array, UInt8Array
from diag_service.decoding.bit_fields import BitField, PayloadWords, UInt64Array, place_signal
from diag_service.definitions.not_available import CodeRange
from diag_service.errors import ConfigError

__all__ = [
    "NO_INVALID",
    "BoolArray",
    "Decoded",
    "InvalidCounts",
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


class InvalidCounts(NamedTuple):
    """Values that are no measurements, by why; a signal that its multiplexer leaves out is none of them."""

    not_available: int = 0  # codes, and floats that are no numbers
    out_of_range: int = 0
    incomplete: int = 0  # a signal that corrects this one has no value

    @property
    def total(self) -> int:
        """All of them."""
        return sum(self)

    def plus(self, more: "InvalidCounts") -> "InvalidCounts":
        """Return the sums, reason by reason."""
        return InvalidCounts(*(one + other for one, other in zip(self, more, strict=True)))


NO_INVALID: Final = InvalidCounts()


@dataclass(frozen=True, slots=True)
class Decoded:
    """One decoded signal: what was sent, and what of it is a measurement."""

    value: FloatArray  # (n,) in the unit of the database
    is_good: BoolArray | None  # (n,) present and a measurement; None: all are
    invalid: InvalidCounts = NO_INVALID
    is_present: BoolArray | None = None  # (n,) in the frame at all; None: in all of them

    @property
    def invalid_count(self) -> int:
        """Values in the frames that are no measurements."""
        return self.invalid.total


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
    not_available: tuple[CodeRange, ...] = ()

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

    def is_code(self, raw: UInt64Array | Int64Array) -> BoolArray | None:
        """Return which raw values say that there is no measurement, shape (n,); None: none can."""
        found: BoolArray | None = None
        kind = raw.dtype.type
        for first, last in self.not_available:
            inside = (raw >= kind(first)) & (raw <= kind(last))
            found = inside if found is None else found | inside
        return found

    def is_outside(self, raw: UInt64Array | Int64Array) -> BoolArray | None:
        """Return which raw values lie outside the range, shape (n,); None: none can."""
        outside: BoolArray | None = None
        kind = raw.dtype.type
        if self.raw_range[0] > self.raw_limits[0]:
            outside = raw < kind(self.raw_range[0])
        if self.raw_range[1] < self.raw_limits[1]:
            above = raw > kind(self.raw_range[1])
            outside = above if outside is None else outside | above
        return outside


@dataclass(frozen=True, slots=True)
class FloatCode:
    """Raw IEEE floats to physical values."""

    length: int
    scale: int | float
    offset: int | float
    value_range: tuple[float, float]

    def raw_number(self, bits: UInt64Array) -> FloatArray:
        """Return the floats that were sent, shape (n,)."""
        unsigned, floating = FLOAT_TYPES[self.length]
        with np.errstate(over="ignore", invalid="ignore"):
            number: FloatArray = bits.astype(unsigned).view(floating).astype(np.float64)
        return number

    def value(self, bits: UInt64Array) -> FloatArray:
        """Return physical values, shape (n,)."""
        value = self.raw_number(bits)
        with np.errstate(over="ignore", invalid="ignore"):
            return value if self.scale == 1 and self.offset == 0 else value * float(self.scale) + float(self.offset)

    def is_outside(self, value: FloatArray) -> BoolArray:
        """Return which values lie outside the range, shape (n,)."""
        return (value < self.value_range[0]) | (value > self.value_range[1])


@dataclass(frozen=True, slots=True)
class SignalTable:
    """A signal, compiled."""

    field: BitField
    code: IntegerCode | FloatCode
    selectors: tuple[Selector, ...]

    def decode(self, words: PayloadWords) -> Decoded:
        """Return the signal in every payload."""
        raw = self.field.raw(words)
        present = self.presence(words) if self.selectors else None
        if isinstance(self.code, FloatCode):
            value = self.code.value(raw.view(np.uint64))
            return _judged(value, present, ~np.isfinite(value), self.code.is_outside(value))
        return _judged(self.code.value(raw), present, self.code.is_code(raw), self.code.is_outside(raw))

    def fits(self, size: int) -> bool:
        """Return whether a payload of ``size`` bytes holds the signal and the multiplexers above it."""
        return all(field.last_byte < size for field in (self.field, *(one.field for one in self.selectors)))

    def cut_off_count(self, words: PayloadWords, size: int) -> int:
        """Return in how many payloads of ``size`` bytes the signal would be, were they longer.

        Where even its multiplexer is cut off, that cannot be known: all are counted.
        """
        if not all(selector.field.last_byte < size for selector in self.selectors):
            return len(words)
        return int(np.count_nonzero(self.presence(words)))

    def presence(self, words: PayloadWords) -> BoolArray:
        """Return which frames carry the signal, as its multiplexers say, shape (n,)."""
        if not self.selectors:
            return np.ones(len(words), np.bool_)
        present = self.selectors[0].is_present(words)
        for selector in self.selectors[1:]:
            present &= selector.is_present(words)
        return present


def _judged(
    value: FloatArray, present: BoolArray | None, is_code: BoolArray | None, is_outside: BoolArray | None
) -> Decoded:
    """Return values with what is known of each; a code that lies outside the range is a code."""
    if is_code is None and is_outside is None:
        return Decoded(value, present, NO_INVALID, present)
    nowhere = np.zeros(len(value), np.bool_)
    codes = nowhere if is_code is None else is_code
    beyond = nowhere if is_outside is None else is_outside & ~codes
    if present is not None:
        codes, beyond = codes & present, beyond & present
    invalid = InvalidCounts(int(np.count_nonzero(codes)), int(np.count_nonzero(beyond)))
    if not invalid.total:
        return Decoded(value, present, invalid, present)
    good = ~(codes | beyond)
    return Decoded(value, good if present is None else good & present, invalid, present)


def payload_words(data: UInt8Array, rows: Int64Array | None = None) -> PayloadWords:
    """Return payloads, shape (n, 8) or (n, 64), as words: some rows of them, or all."""
    return PayloadWords(data, rows)


def compile_signal(
    message: Message, signal: Signal, *, check_range: bool = True, codes: tuple[CodeRange, ...] = ()
) -> SignalTable:
    """Return the table of one signal.

    Parameters
    ----------
    message : Message
        Message as cantools parsed it.
    signal : Signal
        One of its signals.
    check_range : bool
        Whether values outside the signal's [min|max] are invalid; some databases have junk there.
    codes : tuple of CodeRange
        Raw values of an integer that are no measurements.

    Raises
    ------
    ConfigError
        If the signal cannot be decoded: outside its message or the 64 bytes of a frame, of a width that its type
        does not have, or multiplexed by something that is no multiplexer.
    """
    where = f"{message.name}.{signal.name}"
    field = place_signal(message, signal)
    factors = (signal.scale, signal.offset)
    if signal.scale == 0 or not all(abs(factor) <= MAX_FACTOR for factor in factors):
        raise ConfigError(f"{where}: scale {signal.scale} and offset {signal.offset} are not usable")
    code = _float_code(signal, where, check_range=check_range) if signal.conversion.is_float else None
    return SignalTable(
        field=field,
        code=code or _integer_code(signal, field, codes, check_range=check_range),
        selectors=_selectors(message, signal, where),
    )


def _integer_code(signal: Signal, field: BitField, codes: tuple[CodeRange, ...], *, check_range: bool) -> IntegerCode:
    """Compile scaling and validity of an integer signal."""
    scale, offset = signal.scale, signal.offset
    if float(scale).is_integer() and float(offset).is_integer():
        scale, offset = int(scale), int(offset)
    raw_limits = field.raw_limits
    return IntegerCode(
        scale=scale,
        offset=offset,
        raw_range=_raw_range(signal, raw_limits) if check_range else raw_limits,
        raw_limits=raw_limits,
        not_available=codes,
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
