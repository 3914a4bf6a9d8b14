"""Several streams of frames, each in its own order, as one in the order of time, and marks that say which is which."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from canlog.errors import SourceError
from canlog.frames import FrameBatch, join


def merged_by_time(
    streams: Iterable[Iterator[FrameBatch]], marked: Callable[[int, FrameBatch], FrameBatch] = lambda _, batch: batch
) -> Iterator[FrameBatch]:
    """Yield the frames of all streams; of frames with the same time those of an earlier stream come first.

    Each stream is held one batch ahead. Where its time jumps back its frames stay in their order. A stream that ends
    is asked for more before another begins with frames of the same time.

    Parameters
    ----------
    marked :
        Returns frames of a stream, by its place, as they shall leave; called as they are due.
    """
    waiting = [(number, stream, batch) for number, stream in enumerate(streams) if (batch := _next(stream)) is not None]
    begun: set[int] = set()
    while len(waiting) > 1:
        horizon_ns, first = min((int(batch.t_ns[-1]), place) for place, (*_, batch) in enumerate(waiting))
        due = [
            0 if place > first and number not in begun and batch.t_ns[0] == horizon_ns else _due(batch, horizon_ns)
            for place, (number, _, batch) in enumerate(waiting)
        ]
        if not any(due):  # the time of every stream jumps back: the one that is behind goes on as it is
            behind = min(range(len(waiting)), key=lambda place: int(waiting[place][2].t_ns[0]))
            due[behind] = len(waiting[behind][2])
        parts = list(zip(waiting, due, strict=True))
        begun.update(number for (number, *_), count in parts if count)
        leaving = [marked(number, batch[:count]) for (number, _, batch), count in parts if count]
        together = join(leaving)
        yield together if len(leaving) == 1 else together[np.argsort(together.t_ns, kind="stable")]
        left = [(number, stream, batch[count:]) for (number, stream, batch), count in parts]
        refilled = [(number, stream, batch if len(batch) else _next(stream)) for number, stream, batch in left]
        waiting = [(number, stream, batch) for number, stream, batch in refilled if batch is not None]
    for number, stream, batch in waiting:
        yield marked(number, batch)
        yield from (marked(number, rest) for rest in stream if len(rest))


def _next(stream: Iterator[FrameBatch]) -> FrameBatch | None:
    return next((batch for batch in stream if len(batch)), None)


def _due(batch: FrameBatch, horizon_ns: int) -> int:
    """Return how many frames from the first come no later."""
    later = np.flatnonzero(batch.t_ns > horizon_ns)
    return int(later[0]) if len(later) else len(batch)


MOST_SOURCES: Final = 256
_UNKNOWN: Final = -1  # the mark of a channel of which no frame came yet


class SourceMarks:
    """The marks of the channels of some logs: their own numbers, or what is free if those are taken.

    Every format numbers channels in its own way, so a number says something within its log only.

    Parameters
    ----------
    names :
        Of the logs, for people.
    begin :
        Called with the place of a log, a channel of it and its mark, when the first frame of it comes.
    """

    def __init__(self, names: Sequence[str], begin: Callable[[int, int, int], object] = lambda *_: None) -> None:
        self._names = names
        self._begin = begin
        self._marks = [np.full(MOST_SOURCES, _UNKNOWN, np.int64) for _ in names]  # by channel
        self._free = set(range(MOST_SOURCES))

    def marked(self, number: int, batch: FrameBatch) -> FrameBatch:
        """Return frames of a log with the marks of their sources; raises SourceError if there are too many."""
        marks = self._marks[number]
        present = np.flatnonzero(np.bincount(batch.channel, minlength=MOST_SOURCES))
        for channel in present[marks[present] == _UNKNOWN].tolist():
            if not self._free:
                raise SourceError(f"{self._names[number]}: more than {MOST_SOURCES} channels of logs at the same time")
            marks[channel] = mark = channel if channel in self._free else min(self._free)
            self._free.remove(mark)
            self._begin(number, channel, mark)
        if np.array_equal(marks[present], present):
            return batch
        return replace(batch, channel=marks[batch.channel].astype(np.uint8))

    def of_log(self, number: int) -> dict[int, int]:
        marks = self._marks[number]
        return {channel: int(marks[channel]) for channel in np.flatnonzero(marks != _UNKNOWN).tolist()}

    def release(self, number: int) -> None:
        """Give the marks of a log that has ended to others."""
        self._free |= set(self.of_log(number).values())
