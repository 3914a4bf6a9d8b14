"""Signals compiled to tables, so that a few array operations decode a column; bit-identical to cantools.

Where a signal lies in a payload, how one array operation reads it out of all payloads, and which raw values are
measurements. A payload is read as 64-bit words that begin at any byte, in either byte order; a signal is a shift and a
mask of one of them. Only a signal of more than 56 bits that lies across nine bytes needs a byte besides.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.arrays import BoolArray, FloatArray, Int64Array, UInt8Array, UInt64Array
from canlog.database.not_available import CodeRange
from canlog.errors import DefinitionError
from canlog.frames import FD_PAYLOAD_BYTES

WORD_BYTES: Final = 8
WORD_BITS: Final = 64
LITTLE_WORD: Final = np.dtype(np.uint64)  # of the machines that numba compiles for


class PayloadWords:
    """Some rows of payloads, or all, as 64-bit words; bytes past the end of the rows are zeros."""

    def __init__(self, data: UInt8Array, rows: Int64Array | None = None, payloads: UInt64Array | None = None) -> None:
        self._data = data
        self.payloads = payload_words(data) if payloads is None else payloads  # (n, words)
        self.rows: Int64Array = np.arange(len(data)) if rows is None else rows
        self._words: dict[tuple[int, bool], UInt64Array] = {}  # each serves many signals

    def __len__(self) -> int:
        return len(self.rows)

    def at(self, rows: Int64Array) -> "PayloadWords":
        """Return some of the rows, given by their places among all."""
        return PayloadWords(self._data, rows, self.payloads)

    def word(self, first_byte: int, *, is_big: bool) -> UInt64Array:
        """Return the eight bytes from ``first_byte`` on, the first of them highest if ``is_big``, shape (n,)."""
        key = first_byte, is_big
        if key not in self._words:
            column, passed = divmod(first_byte, WORD_BYTES)
            word = self._column(column)
            if passed:
                bits = np.uint64(8 * passed)
                word = word >> bits | self._column(column + 1) << (np.uint64(WORD_BITS) - bits)
            self._words[key] = word.byteswap() if is_big else word
        return self._words[key]

    def _column(self, number: int) -> UInt64Array:
        if number < self.payloads.shape[1]:
            column: UInt64Array = self.payloads[self.rows, number]
            return column
        return np.zeros(len(self), np.uint64)


def payload_words(data: UInt8Array) -> UInt64Array:
    """Return payloads as little-endian words, shape (n, words); zeros fill the last one."""
    missing = -data.shape[1] % WORD_BYTES
    whole = np.pad(data, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(data)
    words: UInt64Array = whole.view(LITTLE_WORD)
    return words if words.flags.aligned and words.flags.writeable else words.copy()  # as loops are compiled for


@dataclass(frozen=True, slots=True)
class BitField:
    """A signal in the word of its byte order that begins at ``first_byte``."""

    is_big: bool
    first_byte: int  # of the word
    last_byte: int  # of the signal
    shift: int
    length: int
    is_signed: bool
    spill: int = 0  # bits by which the signal reaches into a ninth byte's side of the word; 0: it does not

    def raw(self, words: PayloadWords) -> UInt64Array | Int64Array:
        """Return the raw values, shape (n,)."""
        word = words.word(self.first_byte, is_big=self.is_big)
        if self.spill:
            word = self._with_ninth_byte(word, words.word(self.first_byte + WORD_BYTES, is_big=False))
        if self.is_signed:
            left = word << np.uint64(WORD_BITS - self.shift - self.length)
            return left.view(np.int64) >> np.int64(WORD_BITS - self.length)
        return (word >> np.uint64(self.shift)) & np.uint64(2**self.length - 1)

    @property
    def raw_limits(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        if self.is_signed:
            return -(2 ** (self.length - 1)), 2 ** (self.length - 1) - 1
        return 0, 2**self.length - 1

    def _with_ninth_byte(self, word: UInt64Array, following: UInt64Array) -> UInt64Array:
        """Return the word moved by ``spill`` bits, so that the whole signal is in it."""
        ninth = following & np.uint64(0xFF)
        if self.is_big:
            return (word << np.uint64(self.spill)) | (ninth >> np.uint64(8 - self.spill))
        return (word >> np.uint64(self.spill)) | (ninth << np.uint64(WORD_BITS - self.spill))


def place_signal(message: Message, signal: Signal) -> BitField:
    """Return where a signal of a message lies.

    Raises DefinitionError if it lies outside its message or a frame's payload, or has more than 64 bits.
    """
    where = f"{message.name}.{signal.name}"
    is_big = signal.byte_order == "big_endian"
    # The database counts bits of a byte from its lowest; in a big-endian word the highest bit of byte 0 comes first.
    first = 8 * (signal.start // 8) + 7 - signal.start % 8 if is_big else signal.start
    if signal.length > WORD_BITS:
        raise DefinitionError(f"{where} has {signal.length} bits; up to {WORD_BITS} are understood")
    if not (signal.length >= 1 and first >= 0 and first + signal.length <= 8 * message.length):
        raise DefinitionError(f"{where} lies outside its message")
    if first + signal.length > 8 * FD_PAYLOAD_BYTES:
        raise DefinitionError(f"{where} lies outside the {FD_PAYLOAD_BYTES} bytes of a CAN FD frame")
    # Words at multiples of eight bytes serve many signals; one that crosses their borders gets a word of its own.
    in_one_word = first // WORD_BITS == (first + signal.length - 1) // WORD_BITS
    first_byte = WORD_BYTES * (first // WORD_BITS) if in_one_word else first // 8
    offset = first - 8 * first_byte
    spill = offset if offset + signal.length > WORD_BITS else 0
    offset -= spill
    return BitField(
        is_big=is_big,
        first_byte=first_byte,
        last_byte=(first + signal.length - 1) // 8,
        shift=WORD_BITS - offset - signal.length if is_big else offset,
        length=signal.length,
        is_signed=signal.is_signed and not signal.conversion.is_float,
        spill=spill,
    )


MAX_FACTOR: Final = 1e100  # beyond any unit; keeps the arithmetic of wide integers finite
EXACT_INTEGER: Final = 2**53  # float64 holds every integer up to here
FLOAT_TYPES: Final = {16: ("u2", "f2"), 32: ("u4", "f4"), 64: ("u8", "f8")}  # bits -> integer and float of that size


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
        if max(-self.raw_limits[0], self.raw_limits[1]) > EXACT_INTEGER:
            return False
        return isinstance(self.scale, float) or (self.scale == 1 and self.offset == 0) or self._has_exact_products()

    def _has_exact_products(self) -> bool:
        """Whether float64 holds every product and sum of integers that can occur."""
        widest = max(-self.raw_limits[0], self.raw_limits[1])
        return widest <= EXACT_INTEGER and widest * abs(self.scale) + abs(self.offset) <= EXACT_INTEGER

    def is_code(self, raw: UInt64Array | Int64Array) -> BoolArray | None:
        """Return which raw values say that there is no measurement, shape (n,); None: none can."""
        is_code: BoolArray | None = None
        kind = raw.dtype.type
        for first, last in self.not_available:
            inside = (raw >= kind(first)) & (raw <= kind(last))
            is_code = inside if is_code is None else is_code | inside
        return is_code

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


def integer_code(signal: Signal, field: BitField, codes: tuple[CodeRange, ...], *, check_range: bool) -> IntegerCode:
    """Compile scaling and validity of an integer signal."""
    scale, offset = signal.scale, signal.offset
    if float(scale).is_integer() and float(offset).is_integer():
        scale, offset = int(scale), int(offset)
    raw_range = lowest, highest = raw_limits = field.raw_limits
    if check_range:  # to the nearest step; an empty range is no range
        ends = sorted((limit - signal.offset) / signal.scale for limit in _physical_range(signal))
        low = max(lowest, math.ceil(ends[0] - 0.5)) if math.isfinite(ends[0]) else lowest
        high = min(highest, math.floor(ends[1] + 0.5)) if math.isfinite(ends[1]) else highest
        raw_range = (low, high) if low <= high else raw_limits
    return IntegerCode(scale=scale, offset=offset, raw_range=raw_range, raw_limits=raw_limits, not_available=codes)


def _physical_range(signal: Signal) -> tuple[float, float]:
    """Return [min|max] of a signal; infinite where the database says nothing, or integers that no float holds."""
    minimum, maximum = signal.minimum, signal.maximum
    low = float(minimum) if minimum is not None and abs(minimum) <= MAX_FACTOR else -math.inf
    high = float(maximum) if maximum is not None and abs(maximum) <= MAX_FACTOR else math.inf
    return (low, high) if low < high else (-math.inf, math.inf)


MAX_MULTIPLEX_DEPTH: Final = 8


class InvalidCounts(NamedTuple):
    """Values that are no measurements, by why; a signal that its multiplexer leaves out is none of them."""

    not_available: int = 0  # codes, and floats that are not numbers
    out_of_range: int = 0
    incomplete: int = 0  # a signal that corrects this one has no value

    @property
    def total(self) -> int:
        return sum(self)

    def plus(self, more: "InvalidCounts") -> "InvalidCounts":
        """Return the sums, reason by reason."""
        return InvalidCounts(*(count + added for count, added in zip(self, more, strict=True)))


NO_INVALID: Final = InvalidCounts()


@dataclass(frozen=True, slots=True)
class Decoded:
    """One decoded signal: what was sent, and what of it is a measurement."""

    value: FloatArray  # (n,) in the unit of the database
    is_good: BoolArray | None  # (n,) present and a measurement; None: all are
    invalid: InvalidCounts = NO_INVALID
    is_present: BoolArray | None = None  # (n,) in the frame at all; None: in all of them


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
class SignalTable:
    """A signal, compiled."""

    field: BitField
    code: IntegerCode | FloatCode
    selectors: tuple[Selector, ...]
    needed_bytes: int  # the least of a payload that holds the signal and the multiplexers above it
    is_plain: bool  # an integer that a float holds, in one word: all of a message are read together
    is_checked: bool  # some of its values may be no measurements

    def decode(self, words: PayloadWords) -> Decoded:
        raw, present = self.field.raw(words), self.presence(words) if self.selectors else None
        value = self.code.value(raw.view(np.uint64)) if isinstance(self.code, FloatCode) else self.code.value(raw)
        return self.judged(value, raw, present)

    def judged(self, value: FloatArray, raw: UInt64Array | Int64Array, present: BoolArray | None = None) -> Decoded:
        """Return values with what is known of each; ``present`` marks the frames that carry it, None: all do."""
        if isinstance(self.code, FloatCode):
            return _judged(value, present, ~np.isfinite(value), self.code.is_outside(value))
        return _judged(value, present, self.code.is_code(raw), self.code.is_outside(raw))

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


def compile_signal(
    message: Message, signal: Signal, *, check_range: bool = True, codes: tuple[CodeRange, ...] = ()
) -> SignalTable:
    """Return the table of one signal.

    Raises DefinitionError if the signal cannot be decoded: outside its message or the 64 bytes of a frame, of a width
    that its type does not have, or multiplexed by something that is no multiplexer.

    Parameters
    ----------
    message : Message
        Message as cantools parsed it.
    signal : Signal
        One of its signals.
    check_range : bool
        Whether values outside the signal's [min|max] are invalid; some databases have junk there.
    codes : tuple of CodeRange
        Raw values of an integer that are no measurements, as ranges that do not overlap.
    """
    where = f"{message.name}.{signal.name}"
    field = place_signal(message, signal)
    factors = (signal.scale, signal.offset)
    if signal.scale == 0 or not all(abs(factor) <= MAX_FACTOR for factor in factors):
        raise DefinitionError(f"{where}: scale {signal.scale} and offset {signal.offset} are not usable")
    code: FloatCode | IntegerCode
    if signal.conversion.is_float:
        if signal.length not in FLOAT_TYPES:
            raise DefinitionError(f"{where}: no float has {signal.length} bits")
        value_range = _physical_range(signal) if check_range else (-math.inf, math.inf)
        code = FloatCode(signal.length, signal.scale, signal.offset, value_range)
    else:
        code = integer_code(signal, field, codes, check_range=check_range)
    selectors = _selectors(message, signal, where) if signal.multiplexer_ids is not None else ()
    return SignalTable(
        field=field,
        code=code,
        selectors=selectors,
        needed_bytes=1 + max(field.last_byte, *(selector.field.last_byte for selector in selectors), 0),
        is_plain=isinstance(code, IntegerCode) and code.is_exact_in_float and not field.spill,
        is_checked=isinstance(code, FloatCode) or code.raw_range != code.raw_limits or len(codes) > 0,
    )


def _selectors(message: Message, signal: Signal, where: str) -> tuple[Selector, ...]:
    """Return the multiplexers that decide whether a signal is in a frame, innermost first."""
    selectors: list[Selector] = []
    while signal.multiplexer_ids is not None:
        multiplexer = {s.name: s for s in message.signals if s.is_multiplexer}.get(signal.multiplexer_signal or "")
        if multiplexer is None or len(selectors) == MAX_MULTIPLEX_DEPTH:
            raise DefinitionError(f"{where} is multiplexed, but its message has no proper multiplexer for it")
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
