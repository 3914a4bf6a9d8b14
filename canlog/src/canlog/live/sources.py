"""The protocol of live sources of frames, and the queue between a receiver and its consumer."""

import asyncio
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Final, Protocol, TypeVar

from canlog.errors import SourceError
from canlog.frames import MAX_GAP_NS, FrameBatch, empty_batch, join

SILENCE_S: Final = 1.5e-9 * MAX_GAP_NS  # frames after it begin another segment
NS_PER_S: Final = 1_000_000_000
RELAXED_S: Final = 0.5  # 2,200 frames of a full bus of 500 kbit/s, a quarter of what the receive buffer holds
EXPECTING_S: Final = 0.1  # no longer than what a shift needs after its end: its end is known before that is over
URGENT_S: Final = 0.01
LATE_S: Final = 0.002  # frames of the moment that is waited for must have arrived

Listener = Callable[[], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceCounts:
    """Frames of a live bus, counted since the source was opened.

    ``received + kernel_dropped`` frames were on the bus; ``received - queue_dropped - unsupported`` were handed over.
    """

    received: int = 0  # read from the interface
    kernel_dropped: int = 0  # lost in the socket's receive buffer, as the kernel counts them
    queue_dropped: int = 0  # read, but the service was too far behind to keep them
    unsupported: int = 0  # neither CAN nor CAN FD
    clock_steps: int = 0  # of the wall clock; bus time does not follow them

    def __add__(self, other: "SourceCounts") -> "SourceCounts":
        names = [field.name for field in fields(self)]
        return SourceCounts(**{name: getattr(self, name) + getattr(other, name) for name in names})


@dataclass(frozen=True, slots=True)
class BusSilence:
    """No frame came for ``SILENCE_S``: the next one begins another segment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkBreak:
    """The bus was away: frames after it begin another segment, whatever their times."""

    problem: str


PartT_co = TypeVar("PartT_co", covariant=True)


class Source(Protocol[PartT_co]):
    """A live bus, part by part, oldest first.

    Iteration ends after ``aclose``, with all frames received until then handed over, and raises ``SourceError`` when
    the bus fails; frames received before the failure are handed over first.
    """

    @property
    def description(self) -> str:
        """Interface and channel, for people."""

    @property
    def counts(self) -> SourceCounts:
        """What has been received and lost until now; exact, also after the source was closed."""

    def __aiter__(self) -> AsyncIterator[PartT_co]:
        """Iterate over the parts."""

    async def aclose(self) -> None:
        """Stop receiving; a second call does nothing."""


FrameSource = Source[FrameBatch | BusSilence]
LiveSource = Source[FrameBatch | BusSilence | LinkBreak]  # what a live run reads: a bus that failed may come back


class ReadSchedule:
    """For how long a source lets frames gather, by what its consumer waits for.

    Frames gather longest while no result is near, and until its bus time once that of the next result is known.
    """

    def __init__(self) -> None:
        self._is_expecting = False
        self._due_ns: int | None = None
        self.on_change: Listener = lambda: None  # called when the source should set its timer anew

    def wait_for(self, *, is_expecting: bool, due_ns: int | None) -> None:
        """Set what the consumer waits for.

        Parameters
        ----------
        is_expecting
            Whether a shift has begun.
        due_ns
            Bus time beyond which the next shift is known in full, if it has ended.
        """
        if (is_expecting, due_ns) != (self._is_expecting, self._due_ns):
            self._is_expecting, self._due_ns = is_expecting, due_ns
            self.on_change()

    def gather_s(self, seen_ns: int | None) -> float:
        """For how long frames may gather that come after bus time ``seen_ns`` [s]."""
        longest_s = EXPECTING_S if self._is_expecting else RELAXED_S
        if self._due_ns is None or seen_ns is None:
            return longest_s
        return min(max((self._due_ns - seen_ns) / NS_PER_S + LATE_S, URGENT_S), longest_s)


QUEUE_FRAMES = 65_536  # ten seconds of a fully loaded 500 kbit/s bus; 1.4 MiB
LINGER_S = 0.02  # small batches cost more to decode than they gain in freshness


class FrameQueue:
    """Carry frames from a receiver, in the loop or in a thread, to one consumer in the loop.

    ``offer`` never waits: what does not fit is dropped and counted, newest first, as the kernel does it.
    ``next_batch`` joins what has gathered, so that the consumer sees few large batches instead of many small ones; it
    waits for that unless the receiver gathers by itself (``linger_s`` 0). Who iterates hears of a silence as well.
    """

    def __init__(self, *, limit: int = QUEUE_FRAMES, linger_s: float = LINGER_S) -> None:
        self._loop = asyncio.get_running_loop()
        self._loop_thread = threading.get_ident()
        self._limit = limit
        self._linger_s = linger_s
        self._lock = threading.Lock()
        self._batches: deque[FrameBatch] = deque()
        self._waiting = 0  # frames in the queue
        self.dropped = 0  # frames
        self._is_silent = False
        self._is_closed = False
        self._error: SourceError | None = None
        self._has_frames = asyncio.Event()
        self._is_urgent = asyncio.Event()
        self._has_room = threading.Event()
        self._has_room.set()

    def wait_for_room(self, timeout_s: float) -> bool:
        """Wait until at most half is full; return whether it is. For a bus that waits for its reader in turn."""
        return self._has_room.wait(timeout_s)

    def offer(self, batch: FrameBatch) -> None:
        """Append frames, as many as fit; to be called from one thread."""
        with self._lock:
            fitting = 0 if self._is_closed else min(len(batch), self._limit - self._waiting)
            self.dropped += len(batch) - fitting
            if fitting == 0:
                return
            self._is_silent = False  # times of these frames tell
            was_empty = self._waiting == 0
            self._batches.append(batch if fitting == len(batch) else batch[:fitting])
            self._waiting += fitting
            is_half_full = self._waiting > self._limit // 2
            if is_half_full:
                self._has_room.clear()
        if was_empty:
            self._signal(self._has_frames)
        if is_half_full:
            self._signal(self._is_urgent)

    def mark_silent(self) -> None:
        """Let the consumer know, after the frames that are in the queue, that the bus has fallen silent."""
        with self._lock:
            self._is_silent = True
        self._signal(self._has_frames)

    def close(self, error: SourceError | None = None) -> None:
        """Let the consumer have what is in the queue, then the error or the end; the first call counts."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            self._error = error
        self._signal(self._has_frames)
        self._signal(self._is_urgent)

    async def __aiter__(self) -> AsyncIterator[FrameBatch | BusSilence]:
        """Iterate over the batches that hold frames, and silences; ends and fails as ``next_batch`` does."""
        while (batch := await self.next_batch()) is not None:
            if len(batch):
                yield batch
            with self._lock:
                is_silent, self._is_silent = self._is_silent, False
            if is_silent:
                yield BusSilence()

    async def next_batch(self) -> FrameBatch | None:
        """Return everything that has gathered, or None at the end.

        Raises SourceError if the queue was closed with one, after the frames before it were taken.
        """
        await self._has_frames.wait()
        if self._linger_s > 0.0:
            with suppress(TimeoutError):
                async with asyncio.timeout(self._linger_s):
                    await self._is_urgent.wait()
        with self._lock:
            batches, self._batches = list(self._batches), deque()
            self._waiting = 0
            self._has_room.set()
            if not self._is_closed:
                self._has_frames.clear()
                self._is_urgent.clear()
        if batches:
            return join(batches)
        if self._error is not None:
            self._raise_error()
        return None if self._is_closed else empty_batch()

    def _raise_error(self) -> None:
        """Raise the error without keeping it: its traceback refers to the queue and its readers."""
        error, self._error = self._error, None
        try:
            if error is not None:
                raise error
        finally:
            del error

    def _signal(self, event: asyncio.Event) -> None:
        if threading.get_ident() == self._loop_thread:
            event.set()
        elif not self._loop.is_closed():  # a receiver thread may outlive the loop for a moment
            self._loop.call_soon_threadsafe(event.set)
