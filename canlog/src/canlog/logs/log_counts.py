"""Counts of what a log holds besides frames: what could not be read, and odd times."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import BinaryIO

import numpy as np

from canlog.arrays import BoolArray
from canlog.frames import EXTENDED_FLAG, FD_FLAG, MAX_GAP_NS, FrameBatch, join

MOST_NOTES = 8
NS_PER_S = 1_000_000_000
FREE_BYTES = 256 * 2**20  # may be read before anything is found
BYTES_PER_PIECE = 64 * 2**10  # a frame and all that comes with it take 20 to 200
FREE_REJECTS = 200_000  # pieces that are no frames; some formats take 10 us for each
REJECTS_PER_PIECE = 20


class LogReject(StrEnum):
    """Why a piece of a log gave no frame."""

    MALFORMED = "malformed"  # not in the grammar of the format
    CUT_OFF = "cut_off"  # the file ends inside it
    GIVEN_UP = "given_up"  # too much without a frame: the rest was not read
    DAMAGED = "damaged"  # a container or object whose size or compression is wrong


@dataclass(slots=True, kw_only=True)
class LogCounts:
    """What a log held, as far as it has been read: its reader adds to it, everyone else gets a `snapshot`."""

    frames: int = 0
    skipped: int = 0  # comments, events and other sound pieces that are no frames
    rejected: dict[LogReject, int] = field(default_factory=dict)
    first_rejected: str = ""  # where and why, for people
    truncated: bool = False  # the file is cut off
    jumps_back: int = 0  # frames whose time lies before that of the frame before
    jumps_ahead: int = 0  # frames after a silence that ends a segment
    first_jump: str = ""  # where and how far, for people
    repeated: int = 0  # frames that equal the one before, time and all
    late: int = 0  # frames that stood later than their times, and were put in order
    most_late_ns: int = 0  # by how much at most
    unfinished: bool = False  # its writer did not close it: frames may be missing at its end
    notes: tuple[str, ...] = ()  # what had to be assumed, for people: a unit, a date that is not understood

    @property
    def first_fault(self) -> str:
        """The first thing that is wrong with the log; empty if nothing is."""
        end = "the file is cut off" if self.truncated else ""
        return self.first_rejected or self.first_jump or end

    def note(self, text: str) -> None:
        """Say what had to be assumed about the log; each thing once, and no more than a few."""
        if text not in self.notes and len(self.notes) < MOST_NOTES:
            self.notes += (text,)

    def reject(self, reason: LogReject, place: str, count: int = 1) -> None:
        """Count pieces that gave no frame; ``place`` is where the first of them is."""
        if count:
            self.first_rejected = self.first_rejected or f"{place}: {reason}"
            self.rejected[reason] = self.rejected.get(reason, 0) + count

    def cut_off(self, place: str, count: int = 1) -> None:
        """Count pieces that the end of the file cut off or left out."""
        self.truncated = True
        self.reject(LogReject.CUT_OFF, place, count)

    def add(self, other: "LogCounts") -> None:
        """Add what another reader of the same log, or the reader of another one, counted."""
        self.frames += other.frames
        self.skipped += other.skipped
        self.truncated |= other.truncated
        self.unfinished |= other.unfinished
        self.jumps_back += other.jumps_back
        self.jumps_ahead += other.jumps_ahead
        self.first_jump = self.first_jump or other.first_jump
        self.repeated += other.repeated
        self.late += other.late
        self.most_late_ns = max(self.most_late_ns, other.most_late_ns)
        self.first_rejected = self.first_rejected or other.first_rejected
        for reason, count in other.rejected.items():
            self.reject(reason, "", count)
        self.notes = tuple(dict.fromkeys((*self.notes, *other.notes)))

    def snapshot(self) -> "LogCounts":
        return replace(self, rejected=dict(self.rejected))


def lost_texts(counts: LogCounts) -> Iterator[str]:
    """Yield what of a log was not read though it should have been."""
    if counts.truncated:
        yield "the log is cut off"
    if counts.first_rejected:
        reasons = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in counts.rejected.items() if count)
        total = sum(counts.rejected.values())
        yield f"{total} pieces of the log are not frames ({reasons}), the first: {counts.first_rejected}"


def assumed_texts(counts: LogCounts) -> Iterator[str]:
    """Yield what had to be assumed about a log, such as a unit, or that nothing is missing at its end."""
    yield from counts.notes
    if counts.unfinished and not counts.truncated:
        yield "the recorder did not close the log, so frames may be missing at its end"


def odd_texts(counts: LogCounts) -> Iterator[str]:
    """Yield what is odd about the frames that were read: times that jump, frames that are there twice or late."""
    if jumps := counts.jumps_back + counts.jumps_ahead:
        yield f"{jumps} jumps of time, {counts.jumps_back} of them back, the first: {counts.first_jump}"
    if counts.repeated:
        yield f"{counts.repeated} frames repeat the one before, time included"
    if counts.late:
        by_ms = f"{counts.most_late_ns / 1e6:.3f}".rstrip("0").rstrip(".")
        yield f"{counts.late} frames stand up to {by_ms} ms later than their times, and were put in order"


class BoundedStream:
    """A file that ends where no log would go on, which is counted as damage.

    As long as frames or other sound pieces come, it goes on: what is found pays for what is read. ``read_bytes`` is how
    much that is until now.
    """

    def __init__(self, stream: BinaryIO, counts: LogCounts) -> None:
        self._stream = stream
        self._counts = counts
        self.read_bytes = 0
        self._has_ended = False

    @property
    def name(self) -> str:
        return str(self._stream.name)

    @property
    def is_live(self) -> bool:
        """Whether a reading that is short shall be used at once, as of a pipe."""
        return bool(getattr(self._stream, "is_live", False))

    def read(self, size: int) -> bytes:
        """Return the next bytes; none once it has ended."""
        content = b"" if self._is_at_end() else self._stream.read(size)
        self.read_bytes += len(content)
        return content

    def readinto(self, buffer: "memoryview | bytearray") -> int:
        """Fill the buffer as far as the file goes; 0 once it has ended."""
        got = 0 if self._is_at_end() else int(self._stream.readinto(buffer))  # type: ignore[attr-defined]  # of every one
        self.read_bytes += got
        return got

    def seek(self, position: int, whence: int = os.SEEK_SET) -> int:
        return self._stream.seek(position, whence)

    def _is_at_end(self) -> bool:
        counts = self._counts
        pieces = counts.frames + counts.skipped
        is_hopeless = (
            self.read_bytes > FREE_BYTES + BYTES_PER_PIECE * pieces
            or sum(counts.rejected.values()) > FREE_REJECTS + REJECTS_PER_PIECE * pieces
        )
        if is_hopeless and not self._has_ended:
            self._has_ended = counts.truncated = True
            counts.reject(LogReject.GIVEN_UP, f"byte {self.read_bytes} or so")
        return self._has_ended


# Least bits of a frame (ISO 11898-1): no stuff bits, payload apart.
STANDARD_BITS, EXTENDED_BITS, BITS_PER_BYTE = 47, 67, 8
FASTEST_BIT_US = 1.0  # 1 Mbit/s
FASTEST_FD_BIT_US = 0.125  # 8 Mbit/s, of the payload of a CAN FD frame
MOST_LOAD_RATIO = 2.0  # adapters that stamp frames by the packet may show more than one for a moment
LEAST_FRAMES = 10
SECONDS, MILLISECONDS, MICROSECONDS = 6, 3, 0  # units of times, as powers of ten of microseconds
UNIT_NAMES = {MICROSECONDS: "microseconds", MILLISECONDS: "milliseconds", SECONDS: "seconds"}


def bus_load_ratio(batch: FrameBatch) -> float:
    """Return the least load of the busiest channel at the fastest bit rates; infinite where time stands still.

    0 for a channel with too few frames to tell.
    """
    return max((_load_ratio(batch[batch.channel == channel]) for channel in np.unique(batch.channel)), default=0.0)


def is_plausible(load_ratio: float) -> bool:
    """Return whether a bus can have such a load."""
    return load_ratio <= MOST_LOAD_RATIO


def likely_unit(batch: FrameBatch) -> tuple[int, list[str]]:
    """Return the unit of times that were read as microseconds, and notes on it.

    The finest unit with which the load is plausible; where it is with none, they stay microseconds.
    """
    load_ratio = bus_load_ratio(batch)
    for unit in (MICROSECONDS, MILLISECONDS, SECONDS):
        if is_plausible(load_ratio / 10**unit):
            if unit == MICROSECONDS:
                return unit, []
            note = (
                f"times are taken as {UNIT_NAMES[unit]}, not microseconds: a bus of 1 Mbit/s would have a load of "
                f"{100 * load_ratio:.0f} %"
            )
            return unit, [note]
    return MICROSECONDS, []


def _load_ratio(batch: FrameBatch) -> float:
    if len(batch) < LEAST_FRAMES:
        return 0.0
    span_us = float(batch.t_ns.max() - batch.t_ns.min()) / 1e3
    overhead = np.where(batch.can_id & np.uint32(EXTENDED_FLAG), EXTENDED_BITS, STANDARD_BITS) * FASTEST_BIT_US
    is_fd = (batch.flags & np.uint8(FD_FLAG)) != 0
    bit_us = np.where(is_fd, FASTEST_FD_BIT_US, FASTEST_BIT_US)
    least_us = np.where(is_fd, STANDARD_BITS / 2.0, overhead) + BITS_PER_BYTE * bit_us * batch.length
    busy_us = float(least_us[1:].sum())
    return busy_us / span_us if span_us else float("inf")


WATCHED_FRAMES = 1_000  # from the first on
LEAST_PER_S = 10  # frames; a slower bus may well have times in whole seconds
WHOLE_SECONDS = "times are whole seconds, with many frames in each: too coarse for friction, which needs milliseconds"

USUAL_STEPS = 3  # least silence in a table of signals: two rows are missing


def longest_step_ns(rows: FrameBatch) -> int:
    """Return after how long a silence a table of signals begins anew: it may be slower than any bus."""
    steps_ns = np.diff(rows.t_ns)
    usual_ns = np.median(steps_ns[steps_ns > 0]) if np.any(steps_ns > 0) else 0
    return max(MAX_GAP_NS, USUAL_STEPS * int(usual_ns))


class TimeWatch:
    """Counts jumps of time and repeated frames; what it finds does not depend on how the log was cut."""

    def __init__(self, counts: LogCounts) -> None:
        self._counts = counts
        self.longest_step_ns = MAX_GAP_NS
        self._last: FrameBatch | None = None
        self._first_ns: int | None = None  # None: unknown, or times are finer than seconds
        self._frame_count = 0

    def look(self, batch: FrameBatch) -> None:
        if self._last is not None and not 0 < int(batch.t_ns[0]) - int(self._last.t_ns[0]) <= self.longest_step_ns:
            self._count_jumps(join([self._last, batch[:1]]), self._frame_count)
        self._count_jumps(batch, self._frame_count + 1)
        self._check_seconds(batch[: max(WATCHED_FRAMES - self._frame_count, 0)])
        self._last = batch[-1:]
        self._frame_count += len(batch)

    def _check_seconds(self, batch: FrameBatch) -> None:
        if len(batch) and self._frame_count == 0:
            self._first_ns = int(batch.t_ns[0])
        if not len(batch) or self._first_ns is None:
            return
        is_crowded = (int(batch.t_ns[-1]) - self._first_ns) * LEAST_PER_S < WATCHED_FRAMES * NS_PER_S
        if (batch.t_ns % NS_PER_S).any():
            self._first_ns = None
        elif self._frame_count + len(batch) == WATCHED_FRAMES and is_crowded:
            self._counts.note(WHOLE_SECONDS)

    def _count_jumps(self, batch: FrameBatch, number: int) -> None:
        counts, steps_ns = self._counts, np.diff(batch.t_ns)
        is_back, is_ahead = steps_ns < 0, steps_ns > self.longest_step_ns
        jumps, stills = np.flatnonzero(is_back | is_ahead), np.flatnonzero(steps_ns == 0)
        if len(jumps) and not counts.first_jump:
            step_s = int(steps_ns[jumps[0]]) / 1e9
            counts.first_jump = f"frame {number + jumps[0] + 1}: time jumps by {step_s:+.6f} s"
        counts.jumps_back += int(np.count_nonzero(is_back))
        counts.jumps_ahead += int(np.count_nonzero(is_ahead))
        if len(stills):
            counts.repeated += int(np.count_nonzero(_are_equal(batch[stills], batch[stills + 1])))


def _are_equal(batch: FrameBatch, other: FrameBatch) -> BoolArray:
    """Return which frames are those of the other batch in all but their times, shape (n,)."""
    is_equal: BoolArray = (batch.data == other.data).all(axis=1) & (batch.can_id == other.can_id)
    is_equal &= (batch.length == other.length) & (batch.flags == other.flags) & (batch.channel == other.channel)
    return is_equal
