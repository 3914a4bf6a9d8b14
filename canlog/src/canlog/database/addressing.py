"""Which message a frame is: by its identifier, by its J1939 parameter group, and from whom it comes.

A J1939 identifier has, from its highest bit, 3 bits of priority, 2 of data page, 8 of PDU format, 8 of PDU specific and
8 of source address (SAE J1939-21). Below a PDU format of 240 (PDU 1) the PDU specific byte is the destination; from 240
on (PDU 2) it belongs to the group. Priority, destination and source address do not say what a frame means.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from cantools.database.can import Message

from canlog.arrays import Int64Array, UInt32Array
from canlog.errors import DefinitionError
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG

J1939: Final = "j1939"
PDU2_FORMATS: Final = 240
FIRST_FAST_GROUP: Final = 0x1_0000  # from here on, in data page 1, a frame may be a piece of a message of NMEA 2000
NULL_ADDRESS: Final = 0xFE  # written in databases for any sender
STANDARD_IDS: Final = 0x800
ANY: Final = -1  # sender or channel: the first one that is heard
NOBODY: Final = -1

_ID_MASK: Final = 0x1FFF_FFFF
_EXTENDED: Final = int(EXTENDED_FLAG)
_NO_DATA: Final = int(REMOTE_FLAG | ERROR_FLAG)
_STANDARD_TABLE, _EXTENDED_TABLE, _GROUP_TABLE = range(3)  # in which messages are looked up
_SENDER_BITS: Final = 9
_ANY_SENDER: Final = 0x100  # beside the 256 source addresses
_EVERYBODY: Final = 0xFF  # the address of all; in a key of PDU 1 any destination
LEAST_FIT: Final = 0.2  # least share of identifiers known, or of messages present, with the right database


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageAddress:
    """How the frames of one message are known."""

    name: str  # of the message, for people
    can_id: int  # without flags
    is_extended: bool
    is_group: bool  # by its J1939 parameter group; else by the whole identifier
    sender: int = ANY  # J1939 source address
    channel: int = ANY
    is_for_one: bool = False  # of J1939: to other destinations its sender has another message


class AddressBook(NamedTuple):
    """Addresses as tables; slots are places in the sequence of addresses."""

    standard: Int64Array  # (2048,) slot of each 11-bit identifier, NOBODY where there is none
    extended: Int64Array  # sorted 29-bit identifiers
    extended_slot: Int64Array
    group: Int64Array  # sorted: group and source address, or group and _ANY_SENDER
    group_slot: Int64Array
    is_group: Int64Array  # (m,) by slot


def message_address(
    message: Message,
    *,
    is_j1939: bool = False,
    sender: int | None = None,
    channel: int | None = None,
    others: Sequence[Message] = (),
) -> MessageAddress:
    """Return how frames of a message are known; without J1939 source address or channel, by the first that is heard.

    With ``is_j1939`` a message with a 29-bit identifier is taken for one of J1939, whatever the database says. Frames
    to destinations for which ``others`` of its group and sender are there are none of its own.
    """
    group, can_id = parameter_group(message.frame_id), message.frame_id
    ids = [other.frame_id for other in others if other.is_extended_frame]
    rivals = [rival for rival in ids if parameter_group(rival) == group]
    return MessageAddress(
        name=message.name,
        can_id=message.frame_id,
        is_extended=message.is_extended_frame,
        is_group=message.is_extended_frame and (is_j1939 or message.protocol == J1939),
        sender=ANY if sender is None else sender,
        channel=ANY if channel is None else channel,
        is_for_one=any((rival ^ can_id) & 0xFF00 and not (rival ^ can_id) & 0xFF for rival in rivals),
    )


def is_of_groups(messages: Sequence[Message], protocol: str) -> bool:
    """Return whether messages of 29 bits that do not say so are of J1939: by all their senders, or their database."""
    is_stated = protocol.startswith(("J1939", "NMEA")) or all(
        message.frame_id & 0xFF == NULL_ADDRESS for message in messages
    )
    return is_stated and bool(messages) and all(message.protocol is None for message in messages)


def parameter_group(can_id: int) -> int:
    """Return the J1939 parameter group number (PGN) of a 29-bit identifier."""
    group = (can_id >> 8) & 0x3FFFF
    return group if (group >> 8) & 0xFF >= PDU2_FORMATS else group & 0x3FF00


def address_book(addresses: Sequence[MessageAddress]) -> AddressBook:
    """Return the tables of some addresses.

    Of messages of one parameter group that several senders have each to themselves, each is known by group and source
    address, as the database writes it; the null address stands for all the others. Those of one sender are known by
    their destination, too; there the address of all does. Raises DefinitionError if two messages cannot be told apart.
    """
    slots: tuple[dict[int, int], ...] = ({}, {}, {})  # by table
    for slot, (table, key) in enumerate(_places(addresses)):
        if slots[table].setdefault(key, slot) != slot:
            raise DefinitionError(f"several messages have the identifier {addresses[slot].can_id:#x}")
    standard = np.full(STANDARD_IDS, NOBODY, np.int64)
    standard[list(slots[_STANDARD_TABLE])] = list(slots[_STANDARD_TABLE].values())
    return AddressBook(
        standard,
        *_sorted_table(slots[_EXTENDED_TABLE]),
        *_sorted_table(slots[_GROUP_TABLE]),
        is_group=np.array([address.is_group for address in addresses], np.int64),
    )


def overwritten(addresses: Sequence[MessageAddress]) -> dict[int, int]:
    """Return the slots of messages whose identifier a later message has, too, with the slot of the last of those."""
    places = _places(addresses)
    last = {place: slot for slot, place in enumerate(places)}
    return {slot: last[place] for slot, place in enumerate(places) if last[place] != slot}


def why_wrong(known: int, ids: int, came: int, messages: int) -> str:
    """Return why a database is probably not that of a bus, empty if it may be: by chance, a few identifiers fit.

    ``known`` of the ``ids`` of a log are in the database, and ``came`` of its ``messages`` are in the log.
    """
    if not ids or not messages or known >= LEAST_FIT * ids or came >= LEAST_FIT * messages:
        return ""
    return (
        f"probably the wrong database: {known} of {ids} identifiers of the log are in it, and {came} of its {messages} "
        "messages are in the log"
    )


def kernel_filters(addresses: Sequence[MessageAddress]) -> tuple[tuple[int, int], ...]:
    """Return identifier and mask, with SocketCAN's flags, that let the data frames of some messages through."""
    return tuple(_kernel_filter(address) for address in addresses)


def _kernel_filter(address: MessageAddress) -> tuple[int, int]:
    if not address.is_extended:
        return address.can_id, STANDARD_IDS - 1 | _EXTENDED | REMOTE_FLAG
    mask = _ID_MASK
    if address.is_group:
        mask = 0x03FF_0000 if (address.can_id >> 16) & 0xFF < PDU2_FORMATS else 0x03FF_FF00
    return address.can_id & mask | _EXTENDED, mask | _EXTENDED | REMOTE_FLAG


def rows_by_slot(slot: Int64Array, count: int) -> Iterator[tuple[int, Int64Array]]:
    """Yield the slots that occur, rising, each with its rows, rising; negative slots are left out."""
    order, begin = sorted_by_slot(slot, count)
    for number in np.flatnonzero(np.diff(begin)).tolist():
        yield number, order[begin[number] : begin[number + 1]]


def sorted_by_slot(slot: Int64Array, count: int) -> tuple[Int64Array, Int64Array]:
    """Return the rows in the order of their slots, and where those of each slot begin, shape (count + 1,).

    Rows of one slot rise; those of negative slots come before the first.
    """
    order = np.argsort(slot.astype(np.min_scalar_type(-count - 1)), kind="stable")  # few bits are sorted fast
    return order, np.cumsum(np.bincount(slot + 1, minlength=count + 1))


def _places(addresses: Sequence[MessageAddress]) -> list[tuple[int, int]]:
    """Return in which table each message is looked up, and its key there."""
    count = Counter(parameter_group(address.can_id) for address in addresses if address.is_group)
    places: list[tuple[tuple[int, int], tuple[int, int]]] = []  # to its destination, and to any
    for address in addresses:
        if not address.is_group:
            place = _EXTENDED_TABLE if address.is_extended else _STANDARD_TABLE, address.can_id
            places.append((place, place))
            continue
        source = address.can_id & 0xFF if address.sender == ANY else address.sender
        if count[parameter_group(address.can_id)] == 1 or source == NULL_ADDRESS:
            source = _ANY_SENDER
        key = (address.can_id >> 8 & 0x3FFFF) << _SENDER_BITS | source
        anybody = _EVERYBODY << _SENDER_BITS if address.can_id >> 16 & 0xFF < PDU2_FORMATS else 0
        places.append(((_GROUP_TABLE, key), (_GROUP_TABLE, key | anybody)))
    shared = Counter(every for _, every in set(places))
    return [
        place if shared[every] > 1 or address.is_for_one else every
        for address, (place, every) in zip(addresses, places, strict=True)
    ]


def _sorted_table(slots: dict[int, int]) -> tuple[Int64Array, Int64Array]:
    """Return keys and slots, sorted by key."""
    items = sorted(slots.items())
    return np.array([key for key, _ in items], np.int64), np.array([slot for _, slot in items], np.int64)


def find_slots(book: AddressBook, can_id: UInt32Array) -> Int64Array:
    """Return the slots of frames, shape (n,); NOBODY for those that are of no known message or carry no data."""
    is_standard = can_id < STANDARD_IDS
    slot = np.where(is_standard, book.standard[np.where(is_standard, can_id, 0)], NOBODY)
    if book.extended.size or book.group.size:
        is_extended = (can_id & np.uint32(_EXTENDED | _NO_DATA)) == _EXTENDED
        slot[is_extended] = _extended_slots(book, (can_id[is_extended] & np.uint32(_ID_MASK)).astype(np.int64))
    return slot


def _extended_slots(book: AddressBook, bare: Int64Array) -> Int64Array:
    """Return the slots of data frames by their 29 bits: of the identifier, else of its group and sender."""
    slot = _slots_of(book.extended, book.extended_slot, bare)
    group = bare >> 8 & 0x3FFFF
    anybody = np.where(group >> 8 & 0xFF < PDU2_FORMATS, group | _EVERYBODY, group)
    for source in (bare & 0xFF, _ANY_SENDER):
        for destination in (group, anybody) if book.group.size else ():
            known = _slots_of(book.group, book.group_slot, destination << _SENDER_BITS | source)
            slot = np.where(slot == NOBODY, known, slot)
    return slot


def _slots_of(keys: Int64Array, slots: Int64Array, key: Int64Array) -> Int64Array:
    """Return what belongs to each key in a table that is sorted by its keys, NOBODY if it has none of it."""
    if not keys.size:
        return np.full(len(key), NOBODY)
    place = np.minimum(np.searchsorted(keys, key), keys.size - 1)
    return np.where(keys[place] == key, slots[place], NOBODY)
