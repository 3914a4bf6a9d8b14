"""All signals of a database: frames in, one table of columns per message out, in the units of the database."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from cantools.database.can import Message

from clutch_model.jit import array_kernel
from diag_service.columns import Int64Array, UInt8Array, UInt32Array
from diag_service.decoding.decode import Decoded, SignalTable, compile_signal, payload_words
from diag_service.decoding.signal_block import SignalBlock
from diag_service.definitions.addressing import (
    NOBODY,
    AddressBook,
    address_book,
    find_slot,
    message_address,
    rows_by_slot,
)
from diag_service.errors import ConfigError
from diag_service.frames import ERROR_FLAG, FD_PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch

_NO_DATA_FRAME = REMOTE_FLAG | ERROR_FLAG


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageTable:
    """A message, compiled; ``refused`` says why a signal cannot be decoded."""

    message: Message
    signals: Mapping[str, SignalTable]
    refused: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageValues:
    """The frames of one message in a batch, and what its signals say."""

    slot: int  # place of the message in the codec
    rows: Int64Array  # (k,) of the batch, rising
    signals: Mapping[str, Decoded]  # (k,) each


class Codec:
    """The messages of a database as tables: every sender of a J1939 parameter group, every channel.

    Frames that are shorter than their message, remote and error frames and those of no message are left out.

    Parameters
    ----------
    messages : sequence of Message
        What to decode.
    is_j1939 : bool
        Match all 29-bit identifiers by parameter group, whatever the database says.
    check_range : bool
        Whether values outside a signal's [min|max] are invalid.

    Raises
    ------
    ConfigError
        If two messages share an identifier.
    """

    def __init__(self, messages: Sequence[Message], *, is_j1939: bool = False, check_range: bool = True) -> None:
        self.tables = tuple(message_table(message, check_range=check_range) for message in messages)
        self._blocks = [SignalBlock(table.signals) for table in self.tables]
        self._book = address_book([message_address(message, is_j1939=is_j1939) for message in messages])
        self._min_length = np.array([min(message.length, FD_PAYLOAD_BYTES) for message in messages], np.int64)

    def decode(self, batch: FrameBatch) -> Iterator[MessageValues]:
        """Yield the messages that are in a batch, in the order of the codec."""
        for slot, rows in self.rows(batch):
            signals = self._blocks[slot].decode(payload_words(batch.data, rows))
            yield MessageValues(slot=slot, rows=rows, signals=signals)

    def rows(self, batch: FrameBatch) -> Iterator[tuple[int, Int64Array]]:
        """Yield each message that is in a batch with its rows."""
        slot = np.empty(len(batch), np.int64)
        find_slots(
            self._book, self._min_length, np.require(batch.can_id, np.uint32, ("C", "W")),
            np.require(batch.length, np.uint8, ("C", "W")), slot,
        )  # fmt: skip
        yield from rows_by_slot(slot, len(self.tables))


def message_table(message: Message, *, check_range: bool = True) -> MessageTable:
    """Return a message with all its signals compiled that can be."""
    signals: dict[str, SignalTable] = {}
    refused: dict[str, str] = {}
    for signal in message.signals:
        try:
            signals[signal.name] = compile_signal(message, signal.name, check_range=check_range)
        except ConfigError as error:
            refused[signal.name] = str(error)
    return MessageTable(message=message, signals=MappingProxyType(signals), refused=MappingProxyType(refused))


@array_kernel
def find_slots(
    book: AddressBook, min_length: Int64Array, can_id: UInt32Array, length: UInt8Array, slot: Int64Array
) -> None:
    """Fill in the message of each frame, NOBODY where there is none or the frame is too short for it."""
    for row in range(can_id.size):
        slot[row] = NOBODY
        if can_id[row] & _NO_DATA_FRAME == 0:
            found = find_slot(book, int(can_id[row]))
            if found != NOBODY and length[row] >= min_length[found]:
                slot[row] = found
