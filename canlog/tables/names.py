"""Names of columns: ``Message.Signal``, and the identifier where that does not tell two signals apart."""

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cantools.database.can import Message

from canlog.decode.codec import MessageTable
from canlog.frames import EXTENDED_FLAG

TEXT_SUFFIX: Final = ".text"  # of the column that names the states beside the numbers
BARE_ID: Final = 0x1FFF_FFFF
Place = tuple[int, str]  # slot of a message in its codec, and its signal


@dataclass(frozen=True, slots=True, kw_only=True)
class TableNames:
    """How messages and signals are called in a table; it depends on the database alone, not on the log."""

    messages: tuple[str, ...]  # by slot
    columns: Mapping[Place, str]

    def of_message(self, slot: int, taken: Iterable[str]) -> "TableNames":
        """Return the names in a table of one message alone: those of its signals, unless they are ``taken``."""
        used = set(taken)
        columns: dict[Place, str] = {}
        for place in (place for place in self.columns if place[0] == slot):
            columns[place] = _unused(place[1], used)
            used |= {columns[place], columns[place] + TEXT_SUFFIX}
        return TableNames(messages=self.messages, columns=columns)


def flagged_id(message: Message) -> int:
    """Return the identifier of a message as its frames have it, with the flag of 29 bits."""
    return int(message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0))


def identifier_text(can_id: int) -> str:
    """Return an identifier with its flags in hexadecimal: eight digits if it has 29 bits, three if it has 11."""
    return f"0x{can_id & BARE_ID:08X}" if can_id & EXTENDED_FLAG else f"0x{can_id & BARE_ID:03X}"


def table_names(tables: Sequence[MessageTable]) -> TableNames:
    """Return names of which no two are alike.

    Messages of one name are called ``Name@0x123``. Dots in names can still make two columns alike: then their messages
    get the identifier, too, and should even that not help, the later column a number.
    """
    count = Counter(table.message.name for table in tables)
    messages = [
        _with_identifier(table.message) if count[table.message.name] > 1 else table.message.name for table in tables
    ]
    wanted = {(slot, name): f"{messages[slot]}.{name}" for slot, table in enumerate(tables) for name in table.signals}
    taken = Counter(name for column in wanted.values() for name in (column, column + TEXT_SUFFIX))
    columns: dict[Place, str] = {}
    used: set[str] = set()
    for (slot, signal), column in wanted.items():
        is_ambiguous = taken[column] > 1 or taken[column + TEXT_SUFFIX] > 1
        name = f"{_with_identifier(tables[slot].message)}.{signal}" if is_ambiguous else column
        if name in used or name + TEXT_SUFFIX in used:
            name = _unused(name, used)
        columns[slot, signal] = name
        used |= {name, name + TEXT_SUFFIX}
    distinct: dict[str, None] = {}
    for name in messages:
        is_taken = name in distinct or name + TEXT_SUFFIX in distinct
        distinct[_unused(name, distinct.keys()) if is_taken else name] = None
    return TableNames(messages=tuple(distinct), columns=columns)


def _with_identifier(message: Message) -> str:
    return f"{message.name}@{identifier_text(flagged_id(message))}"


def _unused(name: str, used: Container[str]) -> str:
    """Return a name, with a number if it or its text column is taken."""
    found, number = name, 1
    while found in used or found + TEXT_SUFFIX in used:
        number += 1
        found = f"{name}#{number}"
    return found
