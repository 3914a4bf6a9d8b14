"""The frames that tables are made of: of one log or several, messages longer than a frame among them, in groups."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Self

import numpy as np

from canlog.arrays import BoolArray, Int64Array, UInt8Array
from canlog.database.addressing import NOBODY
from canlog.decode.codec import Codec, FrameFate, FrameMatch, MessageValues
from canlog.decode.signals import PayloadWords
from canlog.errors import SourceError
from canlog.frames import COLUMNS, PAYLOAD_BYTES, FrameBatch, empty_batch, join
from canlog.logs import STANDARD_INPUT, LogCounts, LogReader, merged_by_time, read_log, shown_name
from canlog.logs.merging import MOST_SOURCES, SourceMarks
from canlog.logs.reading import Watch, named_error
from canlog.logs.streams import kept, never, open_standard_input
from canlog.transport import Reassembler, Transfer, TransferCounts


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelOrigins:
    """Where frames of several logs come from, by the mark that stands for their channel; changes as they are read."""

    names: tuple[str, ...]  # of the logs
    log: Int64Array = field(default_factory=lambda: np.zeros(MOST_SOURCES, np.int64))  # place in ``names``
    channel: Int64Array = field(default_factory=lambda: np.arange(MOST_SOURCES))

    def begin(self, number: int, channel: int, mark: int) -> None:
        """Let a mark stand for a channel of a log from now on."""
        self.log[mark], self.channel[mark] = number, channel


class LogSet:
    """Some logs as one stream of frames. Standard input that is to be read twice is kept in a file while it is open.

    Parameters
    ----------
    paths :
        The logs; with several of them ``origins`` tells where a frame came from.
    is_stopped :
        Whether to wait no longer for standard input.
    watch :
        Called after each batch of a log, and at its end, with its reader.
    is_read_twice :
        Whether the frames are asked for more than once.
    columns :
        Which column of a text is which, as ``read_log`` takes it.

    Raises
    ------
    SourceError
        When it is entered, if standard input cannot be read.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        is_stopped: Callable[[], bool] = never,
        *,
        is_read_twice: bool = False,
        watch: Watch | None = None,
        columns: str = "",
    ) -> None:
        self.paths = tuple(paths)
        self.readers: list[LogReader] = []  # of the last reading
        # Bytes that are no text become escapes.
        names = (shown_name(one).encode(errors="surrogateescape").decode(errors="backslashreplace") for one in paths)
        self.origins = ChannelOrigins(names=tuple(names)) if len(paths) > 1 else None
        self._is_stopped = is_stopped
        self._watch = watch
        self._columns = columns
        self._is_kept = is_read_twice and STANDARD_INPUT in paths
        self._kept_path = STANDARD_INPUT
        self._opened = ExitStack()

    def __enter__(self) -> Self:
        if self._is_kept:
            try:
                pieces = open_standard_input(self._is_stopped).pieces(self._is_stopped)
                file = self._opened.enter_context(kept(pieces))
            except (OSError, SourceError) as exc:
                raise named_error(shown_name(STANDARD_INPUT), exc) from exc
            self._kept_path = Path(str(file.name))
        return self

    def __exit__(self, *_: object) -> None:
        self._close_readers()
        self._opened.close()

    def frames(self) -> Iterator[FrameBatch]:
        """Yield all frames from the first; raises SourceError."""
        self._close_readers()
        is_stopped, watch, columns = self._is_stopped, self._watch, self._columns
        for path in self.paths:
            source, name = self._kept_path if path == STANDARD_INPUT else path, shown_name(path)
            self.readers.append(read_log(source, is_stopped=is_stopped, watch=watch, name=name, columns=columns))
        origins = self.origins
        if origins is None:
            yield from self.readers[0]
            return
        marks = SourceMarks(origins.names, origins.begin)
        yield from merged_by_time([self._of(number, marks) for number in range(len(self.readers))], marks.marked)

    @property
    def counts(self) -> LogCounts:
        """What the logs held, those of several added up."""
        if self.origins is None:
            return self.readers[0].counts
        total = LogCounts()
        for reader in self.readers:
            total.add(_with_name(reader.counts, reader.name))
        return total

    def _of(self, number: int, marks: SourceMarks) -> Iterator[FrameBatch]:
        yield from self.readers[number]
        marks.release(number)

    def _close_readers(self) -> None:
        for reader in self.readers:
            reader.close()
        self.readers.clear()


def _with_name(counts: LogCounts, name: str) -> LogCounts:
    """Return the counts of one of several logs, with its name before what is for people."""
    for place in ("first_rejected", "first_jump"):
        if text := getattr(counts, place):
            setattr(counts, place, f"{name}: {text}")
    counts.notes = tuple(f"{name}: {note}" for note in counts.notes)
    return counts


def log_paths(path: Path | str | Sequence[Path | str]) -> list[Path]:
    """Return one log or several as a list; raises SourceError if there is none."""
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(one) for one in path]
    if not paths:
        raise SourceError("no log is named")
    return paths


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
class FrameStretch:
    """Frames, and among them a row without a payload for each message that is whole by a frame before it."""

    batch: FrameBatch
    slot: Int64Array  # (n,) message of each frame; NOBODY in a row of a long message
    match: FrameMatch  # of the frames alone
    long: LongPayloads | None = None


class LongRows:
    """Puts the messages of a stream together that the database calls longer than a frame."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._lengths = [table.needed_bytes if table.signals else 0 for table in codec.tables]
        self._reassembler: Final = Reassembler() if any(self._lengths) else None
        self.counts_of: dict[int, int] = {}  # messages that are whole, by slot

    @property
    def counts(self) -> TransferCounts:
        """What became of all messages until now."""
        return self._reassembler.counts if self._reassembler else TransferCounts()

    def stretches(self, batches: Iterable[FrameBatch]) -> Iterator[FrameStretch]:
        """Yield batches with the messages that are whole by them."""
        for batch in batches:
            match = self._codec.match(batch)
            found = self._known(self._reassembler.feed(batch)) if self._reassembler else []
            yield (
                self._stretch(batch, match, found) if found else FrameStretch(batch=batch, slot=match.slot, match=match)
            )
        if self._reassembler and (found := self._known(self._reassembler.close())):
            rest = empty_batch()
            yield self._stretch(rest, self._codec.match(rest), found)

    def _known(self, transfers: Sequence[Transfer]) -> list[tuple[int, Transfer]]:
        """Return the messages that the database calls longer than a frame, with their slots."""
        found = []
        slots = self._codec.slots_of([one.can_id for one in transfers])
        for one, slot in zip(transfers, slots.tolist(), strict=True):
            if slot != NOBODY and self._lengths[slot]:
                found.append((slot, one))
                self.counts_of[slot] = self.counts_of.get(slot, 0) + 1
        return found

    def _stretch(self, batch: FrameBatch, match: FrameMatch, found: Sequence[tuple[int, Transfer]]) -> FrameStretch:
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
        return FrameStretch(batch=whole, slot=np.insert(match.slot, places, NOBODY), match=match, long=payloads)


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


class FrameStock:
    """Frames of several batches, of the messages of a codec.

    Parameters
    ----------
    origins
        Where frames of several logs come from; asked when they are added, since it changes.
    most_frames, most_values
        After how many frames, or values, a group is complete.
    """

    def __init__(self, codec: Codec, origins: ChannelOrigins | None, most_frames: int, most_values: int) -> None:
        self._values_of = np.array([len(table.signals) for table in codec.tables], np.int64)  # in a frame, at most
        self._origins, self._most_frames, self._most_values = origins, most_frames, most_values
        self._has_short = np.zeros(len(codec.tables), np.bool_)
        self._parts: list[FrameGroup] = []
        self._frame_count = self._value_count = 0

    def add(self, stretch: FrameStretch) -> Iterator[FrameGroup]:
        """Take frames with their messages; yield the groups that are complete by them."""
        batch, slot, long = stretch.batch, stretch.slot, stretch.long
        self._has_short |= stretch.match.counts[:-1, FrameFate.SHORT] > 0
        size = max(1, min(self._most_frames, self._most_values // max(1, int(self._values_of.max(initial=1)))))
        for start in range(0, len(batch), size):
            part = slice(start, start + size)
            self._add(batch[part], slot[part], None if long is None else long.between(start, start + size))
            if self._frame_count >= self._most_frames or self._value_count >= self._most_values:
                yield self._taken()

    def rest(self) -> Iterator[FrameGroup]:
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
        if self._origins is not None:
            log, channel = self._origins.log[channel], self._origins.channel[channel]
        one = FrameGroup(frames=batch, slot=slot, channel=channel, log=log, has_short=self._has_short, long=long)
        self._parts.append(one)
        self._frame_count += len(slot) if batch.width <= PAYLOAD_BYTES else 2 * len(slot)  # CAN FD takes more memory
        self._value_count += int(self._values_of[slot].sum())

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
