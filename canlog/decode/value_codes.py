"""Raw values to physical ones, in the very operations of cantools, and which of them are measurements."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from cantools.database.can.signal import Signal

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.database.not_available import CodeRange
from canlog.decode.bit_fields import BitField, UInt64Array
from canlog.errors import DefinitionError

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


def integer_code(signal: Signal, field: BitField, codes: tuple[CodeRange, ...], *, check_range: bool) -> IntegerCode:
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


def float_code(signal: Signal, where: str, *, check_range: bool) -> FloatCode:
    """Compile scaling and validity of a float signal."""
    if signal.length not in FLOAT_TYPES:
        raise DefinitionError(f"{where}: no float has {signal.length} bits")
    value_range = _physical_range(signal) if check_range else (-math.inf, math.inf)
    return FloatCode(signal.length, signal.scale, signal.offset, value_range)
