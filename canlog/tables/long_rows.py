"""Messages longer than a frame as rows of batches: each where its last frame came."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.database.addressing import NOBODY
from canlog.decode.codec import Codec, FrameMatch, MessageValues
from canlog.decode.signals import PayloadWords
from canlog.frames import COLUMNS, FrameBatch, empty_batch
from canlog.transport import Reassembler, Transfer, TransferCounts
from canlog.transport.long_messages import fast_groups


@dataclass(frozen=True, slots=True, kw_only=True)
class LongPayloads:
    """Payloads of messages that were put together, and which rows of a batch they are."""

    rows: Int64Array  # (n,) rising
    slot: Int64Array  # (n,) message of each in the codec
    length: Int64Array  # (n,) bytes
    data: UInt8Array  # (n, width), zeros behind the length

    def __len__(self) -> int:
        return len(self.rows)

    def values(self, codec: Codec) -> Iterator[MessageValues]:
        """Yield what their signals say, short ones apart, by their length."""
        for slot in np.unique(self.slot).tolist():
            own = np.flatnonzero(self.slot == slot)
            sizes = np.minimum(self.length[own], codec.tables[slot].message.length)
            for size in np.unique(sizes)[::-1].tolist():
                rows = own[sizes == size]
                yield codec.values(slot, self.rows[rows], PayloadWords(self.data, rows), size)

    def between(self, start: int, stop: int) -> "LongPayloads | None":
        """Return those in some rows, which are counted from ``start`` on; None if there are none."""
        first, last = np.searchsorted(self.rows, (start, stop)).tolist()
        if first == last:
            return None
        kept = slice(first, last)
        return LongPayloads(
            rows=self.rows[kept] - start, slot=self.slot[kept], length=self.length[kept], data=self.data[kept]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Frames, and among them a row without a payload for each message that is whole by a frame before it."""

    batch: FrameBatch
    slot: Int64Array  # (n,) message of each frame; NOBODY in a row of a long message
    match: FrameMatch  # of the frames alone
    long: LongPayloads | None = None


class LongRows:
    """Puts the messages of a stream together that the database calls longer than a frame.

    Where there are none, nothing is done. ``pairs`` are further identifiers, as of `Reassembler`.
    """

    def __init__(self, codec: Codec, pairs: Collection[tuple[int, int]] = ()) -> None:
        self._codec = codec
        self._lengths = [table.needed_bytes if table.signals else 0 for table in codec.tables]
        self._reassembler: Final = Reassembler(fast_groups(codec.tables), pairs)
        self._is_needed = any(self._lengths)
        self.counts_of: dict[int, int] = {}  # messages that are whole, by slot

    @property
    def counts(self) -> TransferCounts:
        """What became of all messages until now."""
        return self._reassembler.counts

    def stretches(self, batches: Iterable[FrameBatch]) -> Iterator[Stretch]:
        """Yield batches with the messages that are whole by them."""
        for batch in batches:
            match = self._codec.match(batch)
            found = self._known(self._reassembler.feed(batch)) if self._is_needed else []
            yield self._stretch(batch, match, found) if found else Stretch(batch=batch, slot=match.slot, match=match)
        if self._is_needed and (found := self._known(self._reassembler.close())):
            rest = empty_batch()
            yield self._stretch(rest, self._codec.match(rest), found)

    def _known(self, transfers: Sequence[Transfer]) -> list[tuple[int, Transfer]]:
        """Return the messages that the database calls longer than a frame, with their slots."""
        found = []
        for one in transfers:
            slot = self._codec.slot_of(one.can_id)
            if slot != NOBODY and self._lengths[slot]:
                found.append((slot, one))
                self.counts_of[slot] = self.counts_of.get(slot, 0) + 1
        return found

    def _stretch(self, batch: FrameBatch, match: FrameMatch, found: Sequence[tuple[int, Transfer]]) -> Stretch:
        found = sorted(found, key=lambda one: one[1].last_ns)
        transfers = [one for _, one in found]
        t_ns = np.array([one.last_ns for one in transfers], np.int64)
        places = np.searchsorted(batch.t_ns, t_ns, side="right")
        added = FrameBatch(
            t_ns=t_ns,
            can_id=np.array([one.can_id for one in transfers], np.uint32),
            length=np.zeros(len(found), np.uint8),
            data=np.zeros((len(found), batch.width), np.uint8),
            channel=np.array([one.channel for one in transfers], np.uint8),
        )
        whole = FrameBatch(
            **{name: np.insert(getattr(batch, name), places, getattr(added, name), axis=0) for name in COLUMNS}
        )
        length = np.array([len(one.data) for one in transfers], np.int64)
        data = np.zeros((len(found), int(length.max())), np.uint8)
        for row, one in enumerate(transfers):
            data[row, : len(one.data)] = np.frombuffer(one.data, np.uint8)
        payloads = LongPayloads(
            rows=places + np.arange(len(places)),
            slot=np.array([slot for slot, _ in found], np.int64),
            length=length,
            data=data,
        )
        return Stretch(batch=whole, slot=np.insert(match.slot, places, NOBODY), match=match, long=payloads)


def joined(parts: Sequence[LongPayloads | None], row_counts: Sequence[int]) -> LongPayloads | None:
    """Return the payloads of batches that become one; None if there are none."""
    starts = np.cumsum([0, *row_counts[:-1]]).tolist()
    found = [(start, part) for start, part in zip(starts, parts, strict=True) if part is not None]
    if not found:
        return None
    width = max(part.data.shape[1] for _, part in found)
    data = [np.pad(part.data, ((0, 0), (0, width - part.data.shape[1]))) for _, part in found]
    return LongPayloads(
        rows=np.concatenate([part.rows + start for start, part in found]),
        slot=np.concatenate([part.slot for _, part in found]),
        length=np.concatenate([part.length for _, part in found]),
        data=np.concatenate(data),
    )
