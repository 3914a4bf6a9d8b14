"""The frames of a drive as one stream, each marked with its source: a channel of one of its logs.

Every format numbers channels in its own way, so a number says something within its log only. Two logs of one time
may be two buses with one number, or one bus with two: what tells them apart is the pair of log and channel.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Protocol

import numpy as np

from canlog.e2e.protection_check import FrameReason
from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.logs import merged_by_time
from diag_service.diagnosis.contributions import ChannelShare, Contributions, LogShare, idle_lines
from diag_service.service.drive import OpenLog

MOST_SOURCES = 256
_UNKNOWN = -1


class SourceFollower(Protocol):
    """Who follows each message from one source, and counts what became of the frames of each."""

    def begin_source(self, source: int, channel: int) -> None:
        """Learn which channel the frames come from that are marked with a source from now on."""

    def source_counts(self, source: int) -> Mapping[FrameReason, int]:
        """Return what became of the frames of a source since it began; reasons that occurred."""

    def end_source(self, source: int) -> None:
        """Follow messages of a source from where they are heard next; its mark may be given anew."""


class DriveFrames:
    """The frames of the logs of a drive, once, merged by time; ``channel`` of a frame is the mark of its source."""

    def __init__(self, logs: Sequence[OpenLog], follower: SourceFollower) -> None:
        self.logs = tuple(logs)
        self._follower = follower
        self._marks = [np.full(MOST_SOURCES, _UNKNOWN, np.int64) for _ in logs]  # by channel
        self._free = set(range(MOST_SOURCES))
        self._ended: dict[int, LogShare] = {}

    def __iter__(self) -> Iterator[FrameBatch]:
        return merged_by_time([self._frames(number) for number in range(len(self.logs))], self._marked)

    def contributions(self, named_channel: int | None, *, is_whole: bool = True) -> Contributions:
        """Return what each log gave until now; of a part of a drive it cannot be told what gives nothing."""
        numbers = range(len(self.logs))
        shares = tuple(self._ended.get(number) or self._share(number) for number in numbers)
        return Contributions(logs=shares, idle=tuple(idle_lines(shares, named_channel)) if is_whole else ())

    def _frames(self, number: int) -> Iterator[FrameBatch]:
        log = self.logs[number]
        yield from chain((log.first,), log.reader)
        self._end(number)  # all of its frames were taken: the merger asks for more only then

    def _marked(self, number: int, batch: FrameBatch) -> FrameBatch:
        """Return frames of a log with the marks of their sources."""
        marks = self._marks[number]
        present = np.flatnonzero(np.bincount(batch.channel, minlength=MOST_SOURCES))
        for channel in present[marks[present] == _UNKNOWN].tolist():
            marks[channel] = self._begin(number, channel)
        if np.array_equal(marks[present], present):
            return batch
        return replace(batch, channel=marks[batch.channel].astype(np.uint8))

    def _begin(self, number: int, channel: int) -> int:
        """Give a channel of a log a mark: its own number, or what is free if that is taken."""
        if not self._free:
            raise SourceError(f"{self.logs[number].path}: more than {MOST_SOURCES} channels of logs at the same time")
        source = channel if channel in self._free else min(self._free)
        self._free.remove(source)
        self._follower.begin_source(source, channel)
        return source

    def _end(self, number: int) -> None:
        self._ended[number] = self._share(number)
        for source in self._sources(number).values():
            self._follower.end_source(source)
            self._free.add(source)

    def _sources(self, number: int) -> dict[int, int]:
        """Return the marks of the channels of a log."""
        marks = self._marks[number]
        return {channel: int(marks[channel]) for channel in np.flatnonzero(marks != _UNKNOWN).tolist()}

    def _share(self, number: int) -> LogShare:
        channels = tuple(
            _channel_share(channel, self._follower.source_counts(source))
            for channel, source in self._sources(number).items()
        )
        return LogShare(path=str(self.logs[number].path), channels=channels)


def _channel_share(channel: int, counts: Mapping[FrameReason, int]) -> ChannelShare:
    used = {FrameReason.OK, FrameReason.UNKNOWN_ID}
    return ChannelShare(
        channel=channel,
        frames=sum(counts.values()),
        decoded=counts.get(FrameReason.OK, 0),
        ignored=counts.get(FrameReason.UNKNOWN_ID, 0),
        rejected={reason.name.lower(): count for reason, count in counts.items() if reason not in used},
    )
