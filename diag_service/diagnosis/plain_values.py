"""Records as values that JSON can carry, and back: enumerations by their values, arrays as lists of numbers."""

from collections.abc import Mapping
from typing import TypeVar

import msgspec
import numpy as np

from canlog.arrays import FloatArray
from fleet_contract import JsonObject

RecordT = TypeVar("RecordT")


def to_plain(record: object) -> JsonObject:
    """Return the fields of a record as plain values; floats survive the round trip bit by bit."""
    plain = msgspec.to_builtins(record, enc_hook=_array_to_list)
    return {key: list(value) if isinstance(value, tuple) else value for key, value in plain.items()}


def from_plain(table: object, kind: type[RecordT]) -> RecordT:
    """Rebuild a record that `to_plain` made plain; unknown keys are ignored, missing ones take their defaults.

    Raises
    ------
    ValueError
        Saying which value cannot be one of the record.
    """
    return msgspec.convert(table, kind, dec_hook=_list_to_array)


def _array_to_list(value: FloatArray | Mapping[object, object]) -> object:
    return dict(value) if isinstance(value, Mapping) else value.tolist()


def _list_to_array(_: type, value: object) -> FloatArray:
    return np.array(value, dtype=np.float64)
