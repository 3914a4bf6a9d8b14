"""What a column holds in one group of rows, packed but not yet compressed."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.parquet.codes import Packer
from canlog.parquet.metadata import DICTIONARY, DIFFERENCES, PLAIN
from canlog.parquet.packing import Int32Array

MOST_DISTINCT_SHARE: Final = 0.7  # of the rows: with more different values they are written as they are
_LENGTH: Final = struct.Struct("<I")
_LEAST_ZERO, _MOST_ZERO = np.array(-0.0).tobytes(), np.array(0.0).tobytes()
Limits = tuple[bytes | None, bytes | None]
UNKNOWN: Final[Limits] = (None, None)


@dataclass(frozen=True, slots=True)
class Content:
    """Values in one encoding, with the entries that they number if it is that of a dictionary."""

    encoding: int
    body: bytes
    limits: Limits = UNKNOWN  # lowest and highest value
    entries: bytes = b""
    entry_count: int = 0


NOTHING: Final = Content(PLAIN, b"")


def numbers(distinct: FloatArray, index: Int32Array, packer: Packer) -> Content:
    """Return numbers: the different ones, and which of them each row has."""
    if len(distinct) > MOST_DISTINCT_SHARE * len(index):
        return Content(PLAIN, distinct[index].tobytes(), _number_limits(distinct))
    body = packer.runs(index, len(distinct))
    return Content(DICTIONARY, body, _number_limits(distinct), distinct.tobytes(), len(distinct))


def whole_numbers(distinct: npt.NDArray[Any], body: bytes) -> Content:
    """Return whole numbers in the type of their column, likewise."""
    limits = distinct.min().tobytes(), distinct.max().tobytes()
    return Content(DICTIONARY, body, limits, distinct.tobytes(), len(distinct))


def names(different: Sequence[str], body: bytes) -> Content:
    """Return texts, likewise."""
    coded = [one.encode(errors="replace") for one in different]
    return Content(DICTIONARY, body, UNKNOWN, b"".join(_LENGTH.pack(len(one)) + one for one in coded), len(coded))


def times(t_ns: Int64Array, packer: Packer) -> Content:
    """Return times: at least one."""
    return Content(DIFFERENCES, packer.differences(t_ns), (t_ns.min().tobytes(), t_ns.max().tobytes()))


def flags(is_true: BoolArray) -> Content:
    """Return truth values."""
    return Content(PLAIN, np.packbits(is_true, bitorder="little").tobytes())


def _number_limits(distinct: FloatArray) -> Limits:
    """Return the limits of numbers; zeros have the sign that leaves no zero out, and a NaN has no place in an order."""
    if not len(distinct):
        return UNKNOWN
    lowest, highest = distinct.min(), distinct.max()
    if np.isnan(lowest):
        return UNKNOWN
    return lowest.tobytes() if lowest else _LEAST_ZERO, highest.tobytes() if highest else _MOST_ZERO
