"""Frames that gather until they are worth a group of rows, with where each came from."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from canlog.arrays import BoolArray, Int64Array
from canlog.database.addressing import NOBODY
from canlog.decode.codec import Codec, FrameFate
from canlog.frames import PAYLOAD_BYTES, FrameBatch, join
from canlog.tables.inputs import Origins
from canlog.tables.long_rows import LongPayloads, Stretch, joined


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameGroup:
    """Frames that have signals, in their order."""

    frames: FrameBatch
    slot: Int64Array  # (n,) message of each in the codec
    channel: Int64Array  # (n,) in its log
    log: Int64Array | None  # (n,) place of its log among several
    has_short: BoolArray  # (messages,) frames of it may be among these that are shorter than it
    long: LongPayloads | None = None  # of messages that are longer than a frame

    def __len__(self) -> int:
        return len(self.slot)

    @property
    def slot_in_frames(self) -> Int64Array:
        """The message of each frame that is one by itself, NOBODY in rows of longer ones."""
        if self.long is None:
            return self.slot
        slot = self.slot.copy()
        slot[self.long.rows] = NOBODY
        return slot


@dataclass(slots=True)
class FrameStock:
    """Frames of several batches.

    Parameters
    ----------
    values_of
        Values in a frame of each message, at most.
    origins
        Where frames of several logs come from; asked when they are added, since it changes.
    most_frames, most_values
        After how many frames, or values, a group is complete.
    """

    values_of: Int64Array
    origins: Origins | None
    most_frames: int
    most_values: int
    _parts: list[FrameGroup] = field(default_factory=list)
    _frame_count: int = 0
    _value_count: int = 0
    _has_short: BoolArray = field(init=False)

    @classmethod
    def of(cls, codec: Codec, origins: Origins | None, most_frames: int, most_values: int) -> "FrameStock":
        """Return an empty stock for the messages of a codec."""
        values_of = np.array([len(table.signals) for table in codec.tables], np.int64)
        return cls(values_of, origins, most_frames, most_values)

    def __post_init__(self) -> None:
        self._has_short = np.zeros(len(self.values_of), np.bool_)

    def add(self, stretch: Stretch) -> Iterator[FrameGroup]:
        """Take frames with their messages; yield the groups that are complete by them."""
        batch, slot, long = stretch.batch, stretch.slot, stretch.long
        self._has_short |= stretch.match.counts[:-1, FrameFate.SHORT] > 0
        size = max(1, min(self.most_frames, self.most_values // max(1, int(self.values_of.max(initial=1)))))
        for start in range(0, len(batch), size):
            part = slice(start, start + size)
            self._add(batch[part], slot[part], None if long is None else long.between(start, start + size))
            if self._frame_count >= self.most_frames or self._value_count >= self.most_values:
                yield self._taken()

    def rest(self) -> Iterator[FrameGroup]:
        """Yield what is left."""
        if self._frame_count:
            yield self._taken()

    def _add(self, batch: FrameBatch, slot: Int64Array, long: LongPayloads | None) -> None:
        if long is not None:
            slot = slot.copy()
            slot[long.rows] = long.slot
        is_kept = slot != NOBODY
        if not is_kept.all():
            batch, slot = batch[is_kept], slot[is_kept]
            if long is not None:
                long = replace(long, rows=(np.cumsum(is_kept) - 1)[long.rows])
        channel, log = batch.channel.astype(np.int64), None
        if self.origins is not None:
            log, channel = self.origins.log[channel], self.origins.channel[channel]
        one = FrameGroup(frames=batch, slot=slot, channel=channel, log=log, has_short=self._has_short, long=long)
        self._parts.append(one)
        self._frame_count += len(slot) if batch.width <= PAYLOAD_BYTES else 2 * len(slot)  # CAN FD takes more memory
        self._value_count += int(self.values_of[slot].sum())

    def _taken(self) -> FrameGroup:
        parts = self._parts
        logs = [part.log for part in parts if part.log is not None]
        whole = FrameGroup(
            frames=join([part.frames for part in parts]),
            slot=np.concatenate([part.slot for part in parts]),
            channel=np.concatenate([part.channel for part in parts]),
            log=np.concatenate(logs) if logs else None,
            has_short=self._has_short.copy(),
            long=joined([part.long for part in parts], [len(part) for part in parts]),
        )
        self._parts, self._frame_count, self._value_count = [], 0, 0
        return whole
