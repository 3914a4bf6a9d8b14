"""The frames that tables are made of: of one log or several, messages longer than a frame among them, in groups."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Final, Self, cast

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.database.addressing import NOBODY
from canlog.decode.codec import Codec, FrameFate, FrameMatch, MessageValues
from canlog.decode.signals import PayloadWords
from canlog.errors import SourceError
from canlog.frames import COLUMNS, FrameBatch, empty_batch, join
from canlog.logs import STANDARD_INPUT, LogCounts, LogReader, merged_by_time, read_log, shown_name
from canlog.logs.reading import Watch, named_error
from canlog.logs.streams import kept, never, open_standard_input
from canlog.transport import Reassembler, Transfer, TransferCounts

LOG_SHIFT: Final = 8  # of the channels of several logs: above them stands the place of the log


class LogSet:
    """Some logs as one stream of frames. Standard input that is to be read twice is kept in a file while it is open.

    Parameters
    ----------
    paths :
        The logs; with several of them ``names`` are theirs, and channels say of which one, too (``LOG_SHIFT``).
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
        self.names = tuple(names) if len(paths) > 1 else ()
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
        if self.names:
            yield from merged_by_time(map(_with_place, count(), self.readers))
        else:
            yield from self.readers[0]

    @property
    def counts(self) -> LogCounts:
        """What the logs held, those of several added up."""
        if not self.names:
            return self.readers[0].counts
        total = LogCounts()
        for reader in self.readers:
            total.add(_with_name(reader.counts, reader.name))
        return total

    def _close_readers(self) -> None:
        for reader in self.readers:
            reader.close()
        self.readers.clear()


def _with_place(place: int, reader: LogReader) -> Iterator[FrameBatch]:
    """Yield the frames of one of several logs, with its place above their channels."""
    for batch in reader:
        channel = batch.channel.astype(np.int64) | place << LOG_SHIFT
        yield replace(batch, channel=cast("UInt8Array", channel))  # wider than elsewhere; layouts take it apart


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


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameGroup:
    """Frames, and among them a row without a payload for each message that is whole by a frame before it."""

    batch: FrameBatch
    slot: Int64Array  # (n,) message of each frame; NOBODY in a row of a long message
    match: FrameMatch  # of the frames alone
    long: LongPayloads | None = None

    def values(self, codec: Codec) -> list[MessageValues]:
        """Return what the signals of the frames say, message by message; not that of the longer messages."""
        has_short = self.match.counts[:-1, FrameFate.SHORT] > 0
        return list(codec.decode_slots(self.batch, self.slot, has_short))


def grouped(batches: Iterable[FrameBatch], most_frames: int, *, is_live: bool = False) -> Iterator[FrameBatch]:
    """Yield frames in larger batches, of no more than so many frames; ``is_live``: what comes together is a batch."""
    waiting, size = list[FrameBatch](), 0
    for batch in batches:
        for start in range(0, len(batch), most_frames):
            part = batch[start : start + most_frames]
            if size + len(part) > most_frames or (is_live and waiting):
                yield join(waiting)
                waiting, size = [], 0
            waiting.append(part)
            size += len(part)
        if is_live and waiting:
            yield join(waiting)
            waiting, size = [], 0
    if waiting:
        yield join(waiting)


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

    def groups(self, batches: Iterable[FrameBatch]) -> Iterator[FrameGroup]:
        """Yield batches with the messages that are whole by them."""
        for batch in batches:
            match = self._codec.match(batch)
            found = self._known(self._reassembler.feed(batch)) if self._reassembler else []
            yield self._group(batch, match, found) if found else FrameGroup(batch=batch, slot=match.slot, match=match)
        if self._reassembler and (found := self._known(self._reassembler.close())):
            rest = empty_batch()
            yield self._group(rest, self._codec.match(rest), found)

    def _known(self, transfers: Sequence[Transfer]) -> list[tuple[int, Transfer]]:
        """Return the messages that the database calls longer than a frame, with their slots."""
        found = []
        slots = self._codec.slots_of([one.can_id for one in transfers])
        for one, slot in zip(transfers, slots.tolist(), strict=True):
            if slot != NOBODY and self._lengths[slot]:
                found.append((slot, one))
                self.counts_of[slot] = self.counts_of.get(slot, 0) + 1
        return found

    def _group(self, batch: FrameBatch, match: FrameMatch, found: Sequence[tuple[int, Transfer]]) -> FrameGroup:
        found = sorted(found, key=lambda one: one[1].last_ns)
        transfers = [one for _, one in found]
        t_ns = np.array([one.last_ns for one in transfers], np.int64)
        places = np.searchsorted(batch.t_ns, t_ns, side="right")
        added = FrameBatch(
            t_ns=t_ns,
            can_id=np.array([one.can_id for one in transfers], np.uint32),
            length=np.zeros(len(found), np.uint8),
            data=np.zeros((len(found), batch.width), np.uint8),
            channel=cast("UInt8Array", np.array([one.channel for one in transfers], batch.channel.dtype)),
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
        return FrameGroup(batch=whole, slot=np.insert(match.slot, places, NOBODY), match=match, long=payloads)
