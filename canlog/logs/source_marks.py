"""Channels of several logs, told apart: each gets a mark, which takes the place of its number in merged frames."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from canlog.errors import SourceError
from canlog.frames import FrameBatch

MOST_SOURCES: Final = 256
_UNKNOWN: Final = -1  # the mark of a channel of which no frame came yet


def _nothing(_number: int, _channel: int, _mark: int) -> None:
    pass


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

    def __init__(self, names: Sequence[str], begin: Callable[[int, int, int], None] = _nothing) -> None:
        self._names = names
        self._begin = begin
        self._marks = [np.full(MOST_SOURCES, _UNKNOWN, np.int64) for _ in names]  # by channel
        self._free = set(range(MOST_SOURCES))

    def marked(self, number: int, batch: FrameBatch) -> FrameBatch:
        """Return frames of a log with the marks of their sources; raises SourceError if there are too many."""
        marks = self._marks[number]
        present = np.flatnonzero(np.bincount(batch.channel, minlength=MOST_SOURCES))
        for channel in present[marks[present] == _UNKNOWN].tolist():
            marks[channel] = self._new_mark(number, channel)
        if np.array_equal(marks[present], present):
            return batch
        return replace(batch, channel=marks[batch.channel].astype(np.uint8))

    def of_log(self, number: int) -> dict[int, int]:
        marks = self._marks[number]
        return {channel: int(marks[channel]) for channel in np.flatnonzero(marks != _UNKNOWN).tolist()}

    def release(self, number: int) -> None:
        """Give the marks of a log that has ended to others."""
        self._free |= set(self.of_log(number).values())

    def _new_mark(self, number: int, channel: int) -> int:
        if not self._free:
            raise SourceError(f"{self._names[number]}: more than {MOST_SOURCES} channels of logs at the same time")
        mark = channel if channel in self._free else min(self._free)
        self._free.remove(mark)
        self._begin(number, channel, mark)
        return mark
