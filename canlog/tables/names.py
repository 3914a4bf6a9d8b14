"""Names of columns: ``Message.Signal``, and the identifier where that does not tell two signals apart."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from cantools.database.can import Message

from canlog.decode.codec import MessageTable

TEXT_SUFFIX = ".text"  # of the column that names the states beside the numbers
Place = tuple[int, str]  # slot of a message in its codec, and its signal


@dataclass(frozen=True, slots=True, kw_only=True)
class TableNames:
    """How messages and signals are called in a table; it depends on the database alone, not on the log."""

    messages: tuple[str, ...]  # by slot
    columns: Mapping[Place, str]


def identifier_text(can_id: int, *, is_extended: bool) -> str:
    """Return an identifier in hexadecimal, with eight digits if it has 29 bits, three if it has 11."""
    return f"0x{can_id:08X}" if is_extended else f"0x{can_id:03X}"


def table_names(tables: Sequence[MessageTable]) -> TableNames:
    """Return names of which no two are alike.

    Messages of one name are called ``Name@0x123``. Dots in names can still make two columns alike: then their messages
    get the identifier, too, and should even that not help, the later column a number.
    """
    count = Counter(table.message.name for table in tables)
    messages = tuple(
        _with_identifier(table.message) if count[table.message.name] > 1 else table.message.name for table in tables
    )
    wanted = {place: f"{messages[place[0]]}.{place[1]}" for place in _places(tables)}
    taken = Counter(name for column in wanted.values() for name in (column, column + TEXT_SUFFIX))
    columns: dict[Place, str] = {}
    used: set[str] = set()
    for place, column in wanted.items():
        name = column
        if taken[column] > 1 or taken[column + TEXT_SUFFIX] > 1:
            name = f"{_with_identifier(tables[place[0]].message)}.{place[1]}"
        columns[place] = _unused(name, used)
        used |= {columns[place], columns[place] + TEXT_SUFFIX}
    return TableNames(messages=_distinct(messages), columns=columns)


def _places(tables: Sequence[MessageTable]) -> Iterator[Place]:
    """Yield all signals that can be decoded, in the order of the database."""
    for slot, table in enumerate(tables):
        for name in table.signals:
            yield slot, name


def _with_identifier(message: Message) -> str:
    return f"{message.name}@{identifier_text(message.frame_id, is_extended=message.is_extended_frame)}"


def _distinct(names: Sequence[str]) -> tuple[str, ...]:
    used: set[str] = set()
    found: list[str] = []
    for name in names:
        found.append(_unused(name, used))
        used.add(found[-1])
    return tuple(found)


def _unused(name: str, used: set[str]) -> str:
    """Return a name, with a number if it or its text column is taken."""
    found, number = name, 1
    while found in used or found + TEXT_SUFFIX in used:
        number += 1
        found = f"{name}#{number}"
    return found
