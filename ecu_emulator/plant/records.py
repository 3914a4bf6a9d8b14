"""Nested parameter tuples as one flat record, which compiled code takes by address."""

from typing import TypeVar, cast

import numpy as np
import numpy.typing as npt

from clutch_model.errors import DomainError

LawT = TypeVar("LawT", bound=tuple[object, ...])


def as_record(law: LawT) -> LawT:
    """Return the numpy record with the members of a nested named tuple of numbers.

    It reads like the tuple it was made of, hence the type. A kernel that gets the tuple itself copies every number
    at every call; the record costs one pointer, and equal members can be indexed (``law.shafts[k]``).

    Raises
    ------
    DomainError
        If a member is neither a number nor a tuple of members of one type.
    """
    record = np.array([_plain(law)], dtype=_dtype_of(law)).view(np.recarray)[0]
    return cast("LawT", record)


def _dtype_of(value: object) -> npt.DTypeLike:
    if isinstance(value, float):
        return np.dtype(np.float64)
    if isinstance(value, int):
        return np.dtype(np.int64)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        members = [(name, _dtype_of(member)) for name, member in zip(value._fields, value, strict=True)]
        return np.dtype(members, align=True)
    if isinstance(value, tuple) and value and len({str(_dtype_of(member)) for member in value}) == 1:
        return np.dtype((_dtype_of(value[0]), (len(value),)))
    raise DomainError(f"not part of a record: {value!r}")


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        members = [_plain(member) for member in value]
        return tuple(members) if hasattr(value, "_fields") else members
    return value
