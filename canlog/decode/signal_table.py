"""Signals compiled to tables, so that a few array operations decode a column; bit-identical to cantools."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.arrays import BoolArray, FloatArray
from canlog.database.not_available import CodeRange
from canlog.decode.bit_fields import BitField, PayloadWords, place_signal
from canlog.decode.value_codes import MAX_FACTOR, FloatCode, IntegerCode, float_code, integer_code
from canlog.errors import DefinitionError
from canlog.frames import FD_PAYLOAD_BYTES

MAX_MULTIPLEX_DEPTH: Final = 8


class InvalidCounts(NamedTuple):
    """Values that are no measurements, by why; a signal that its multiplexer leaves out is none of them."""

    not_available: int = 0  # codes, and floats that are not numbers
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
class SignalTable:
    """A signal, compiled."""

    field: BitField
    code: IntegerCode | FloatCode
    selectors: tuple[Selector, ...]

    def decode(self, words: PayloadWords) -> Decoded:
        raw = self.field.raw(words)
        present = self.presence(words) if self.selectors else None
        if isinstance(self.code, FloatCode):
            value = self.code.value(raw.view(np.uint64))
            return _judged(value, present, ~np.isfinite(value), self.code.is_outside(value))
        return _judged(self.code.value(raw), present, self.code.is_code(raw), self.code.is_outside(raw))

    @property
    def needed_bytes(self) -> int:
        """The least bytes of a payload that holds the signal and the multiplexers above it."""
        return 1 + max(field.last_byte for field in (self.field, *(one.field for one in self.selectors)))

    def fits(self, size: int) -> bool:
        """Return whether a payload of ``size`` bytes holds the signal and the multiplexers above it."""
        return self.needed_bytes <= size

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
    message: Message,
    signal: Signal,
    *,
    check_range: bool = True,
    codes: tuple[CodeRange, ...] = (),
    most_bytes: int = FD_PAYLOAD_BYTES,
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
        Raw values of an integer that are no measurements, as ranges that do not overlap.
    most_bytes : int
        Of a payload: those of a CAN FD frame, more for messages that are put together.

    Raises
    ------
    DefinitionError
        If the signal cannot be decoded: outside its message or the 64 bytes of a frame, of a width that its type
        does not have, or multiplexed by something that is no multiplexer.
    """
    where = f"{message.name}.{signal.name}"
    field = place_signal(message, signal, most_bytes)
    factors = (signal.scale, signal.offset)
    if signal.scale == 0 or not all(abs(factor) <= MAX_FACTOR for factor in factors):
        raise DefinitionError(f"{where}: scale {signal.scale} and offset {signal.offset} are not usable")
    code = float_code(signal, where, check_range=check_range) if signal.conversion.is_float else None
    return SignalTable(
        field=field,
        code=code or integer_code(signal, field, codes, check_range=check_range),
        selectors=_selectors(message, signal, where, most_bytes),
    )


def _selectors(message: Message, signal: Signal, where: str, most_bytes: int) -> tuple[Selector, ...]:
    """Return the multiplexers that decide whether a signal is in a frame, innermost first."""
    selectors: list[Selector] = []
    while signal.multiplexer_ids is not None:
        multiplexer = {s.name: s for s in message.signals if s.is_multiplexer}.get(signal.multiplexer_signal or "")
        if multiplexer is None or len(selectors) == MAX_MULTIPLEX_DEPTH:
            raise DefinitionError(f"{where} is multiplexed, but its message has no proper multiplexer for it")
        selectors.append(_selector(place_signal(message, multiplexer, most_bytes), signal.multiplexer_ids))
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
