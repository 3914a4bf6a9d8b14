"""Columns of a table as messages: one signal each, an IEEE 754 double under an identifier made of the column's name.

Whoever knows the name of a column knows its identifier, so that a table can be decoded without being asked first.
"""

import zlib
from collections.abc import Iterable
from typing import Final, NamedTuple

from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion
from cantools.database.errors import Error as CantoolsError

from canlog.errors import DefinitionError

VALUE_BITS: Final = 64
IDENTIFIER_BITS: Final = 0x1FFF_FFFF  # of an extended frame


class SignalColumn(NamedTuple):
    """A column of a table: what its header calls it, and the unit beside the name, empty if there is none."""

    name: str
    unit: str


def column_id(name: str) -> int:
    """Return the 29-bit identifier under which the values of a column travel."""
    return zlib.crc32(name.encode()) & IDENTIFIER_BITS


def columns_database(columns: Iterable[SignalColumn]) -> Database:
    """Return a database with a message for each column, called as the column is, and a signal of the same name.

    Raises DefinitionError if two names make the same identifier.
    """
    messages: dict[int, Message] = {}
    for name, unit in columns:
        can_id = column_id(name)
        if can_id in messages and messages[can_id].name != name:
            raise DefinitionError(
                f"the columns {messages[can_id].name!r} and {name!r} cannot be told apart: rename one"
            )
        value = Signal(
            name, 0, VALUE_BITS, is_signed=True, unit=unit or None, conversion=BaseConversion.factory(is_float=True)
        )
        messages[can_id] = Message(can_id, name, VALUE_BITS // 8, [value], is_extended_frame=True)
    try:
        return Database(messages=list(messages.values()))
    except CantoolsError as exc:
        raise DefinitionError(f"the columns cannot be told apart: {exc}") from exc
