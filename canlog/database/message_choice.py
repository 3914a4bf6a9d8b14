"""Which messages of a database count: of one bus, or of all, as long as no identifier means two things."""

import logging
from pathlib import Path
from typing import Final

from cantools.database.can import Database, Message

from canlog.errors import DefinitionError

_LOG: Final = logging.getLogger(__name__)
_MARK: Final = "#"


def bus_of(path: Path) -> tuple[Path, str]:
    """Return the file and the bus that ``FILE#BUS`` names; without a bus, or if there is such a file, no bus."""
    name, mark, bus = path.name.rpartition(_MARK)
    if not mark or not name or path.exists():
        return path, ""
    return path.with_name(name), bus


def chosen_messages(database: Database, bus: str, path: Path, *, is_lenient: bool) -> Database:
    """Return a database with the messages that count.

    Parameters
    ----------
    bus : str
        Whose messages are wanted; empty: of all.
    is_lenient : bool
        Leave out messages whose identifier another one before them has.

    Raises
    ------
    DefinitionError
        If there is no such bus, or two buses use one identifier and none of them was named.
    """
    buses = list(dict.fromkeys(message.bus_name for message in database.messages if message.bus_name))
    if bus and bus not in buses:
        raise DefinitionError(f"{path} has no bus {bus!r}; it has {', '.join(buses) or 'none by name'}")
    wanted = [message for message in database.messages if not bus or message.bus_name == bus]
    first: dict[tuple[int, bool], Message] = {}
    kept: list[Message] = []
    for message in wanted:
        other = first.setdefault((message.frame_id, message.is_extended_frame), message)
        if other is not message:
            said = _twice(message, other)
            if other.bus_name != message.bus_name:
                raise DefinitionError(f"{path}: {said}; name one of them: {path}{_MARK}{message.bus_name}")
            _LOG.warning("%s: %s%s", path, said, " (left out)" if is_lenient else "")
        if other is message or not is_lenient:
            kept.append(message)
    if len(kept) == len(database.messages):
        return database
    return Database(
        messages=kept, nodes=database.nodes, buses=database.buses, version=database.version,
        dbc_specifics=database.dbc, strict=False,
    )  # fmt: skip


def _twice(message: Message, other: Message) -> str:
    places = (f"{one.name} of {one.bus_name}" if one.bus_name else one.name for one in (other, message))
    return f"the identifier {message.frame_id:#x} belongs to {' and to '.join(places)}"
