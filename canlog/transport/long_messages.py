"""Messages longer than a frame, decoded by the database."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from cantools.database import DecodeError
from cantools.database.can import Message

from canlog.database.addressing import FIRST_FAST_GROUP, J1939, NOBODY, parameter_group
from canlog.decode.codec import Codec, MessageTable
from canlog.frames import PAYLOAD_BYTES, FrameBatch
from canlog.transport.fast_packet import LONGEST as LONGEST_FAST
from canlog.transport.reassembly import Reassembler
from canlog.transport.transfers import Transfer, TransferCounts


@dataclass(frozen=True, slots=True, kw_only=True)
class LongMessage:
    """A message that was put together, and what it says in the units of the database; nothing if that knows it not."""

    transfer: Transfer
    name: str = ""
    values: dict[str, float | int] | None = None
    fault: str = ""  # why the database cannot decode it


class LongMessages:
    """The messages of a stream that are longer than a frame.

    A group of J1939 of more than eight bytes whose own identifier comes is taken for a fast packet of NMEA 2000.
    ``pairs`` are further identifiers of requests and answers, as of `Reassembler`.
    """

    def __init__(self, messages: Sequence[Message], pairs: Collection[tuple[int, int]] = ()) -> None:
        self._codec = Codec(messages, has_long=True)
        self._reassembler = Reassembler(fast_groups=fast_groups(self._codec.tables), pairs=pairs)

    @property
    def counts(self) -> TransferCounts:
        """What became of all messages until now."""
        return self._reassembler.counts

    def feed(self, batch: FrameBatch) -> Iterator[LongMessage]:
        """Yield the messages that are whole by the frames that follow."""
        yield from map(self._decoded, self._reassembler.feed(batch))

    def close(self) -> Iterator[LongMessage]:
        """End, and yield what is whole now."""
        yield from map(self._decoded, self._reassembler.close())

    def _decoded(self, transfer: Transfer) -> LongMessage:
        slot = self._codec.slot_of(transfer.can_id)
        if slot == NOBODY:
            return LongMessage(transfer=transfer)
        message = self._codec.tables[slot].message
        try:
            decoded = message.decode(transfer.data, decode_choices=False, allow_truncated=True)
        except (DecodeError, ValueError) as exc:
            return LongMessage(transfer=transfer, name=message.name, fault=str(exc))
        if not isinstance(decoded, dict):
            return LongMessage(transfer=transfer, name=message.name, fault="a container of other messages")
        values = {name: value for name, value in decoded.items() if isinstance(value, int | float)}
        if not values and len(transfer.data) < message.length:
            return LongMessage(transfer=transfer, name=message.name, fault="shorter than the database says")
        return LongMessage(transfer=transfer, name=message.name, values=values)


def fast_groups(tables: Sequence[MessageTable]) -> frozenset[int]:
    """Return the groups whose own frames can be no more than pieces: fast packets of NMEA 2000, all of data page 1."""
    messages = [table.message for table in tables if PAYLOAD_BYTES < table.needed_bytes <= LONGEST_FAST]
    groups = {parameter_group(one.frame_id) for one in messages if one.is_extended_frame and one.protocol == J1939}
    return frozenset(group for group in groups if group >= FIRST_FAST_GROUP)
