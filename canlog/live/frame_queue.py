"""The one bounded queue between a receiver and the service."""

import asyncio
import threading
from collections import deque
from collections.abc import AsyncIterator

from canlog.errors import SourceError
from canlog.frames import FrameBatch, empty_batch, join
from canlog.live.sources import Silence

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
        self._dropped = 0
        self._is_silent = False
        self._is_closed = False
        self._error: SourceError | None = None
        self._has_frames = asyncio.Event()
        self._is_urgent = asyncio.Event()

    @property
    def dropped(self) -> int:
        return self._dropped

    def offer(self, batch: FrameBatch) -> None:
        """Append frames, as many as fit; to be called from one thread."""
        with self._lock:
            fitting = 0 if self._is_closed else min(len(batch), self._limit - self._waiting)
            self._dropped += len(batch) - fitting
            if fitting == 0:
                return
            self._is_silent = False  # times of these frames tell
            was_empty = self._waiting == 0
            self._batches.append(batch if fitting == len(batch) else batch[:fitting])
            self._waiting += fitting
            is_half_full = self._waiting > self._limit // 2
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

    async def __aiter__(self) -> AsyncIterator[FrameBatch | Silence]:
        """Iterate over the batches that hold frames, and silences; ends and fails as ``next_batch`` does."""
        while (batch := await self.next_batch()) is not None:
            if len(batch):
                yield batch
            with self._lock:
                is_silent, self._is_silent = self._is_silent, False
            if is_silent:
                yield Silence()

    async def next_batch(self) -> FrameBatch | None:
        """Return everything that has gathered, or None at the end.

        Raises SourceError if the queue was closed with one, after the frames before it were taken.
        """
        await self._has_frames.wait()
        if self._linger_s > 0.0:
            try:
                async with asyncio.timeout(self._linger_s):
                    await self._is_urgent.wait()
            except TimeoutError:
                pass
        with self._lock:
            batches, self._batches = list(self._batches), deque()
            self._waiting = 0
            if not self._is_closed:
                self._has_frames.clear()
                self._is_urgent.clear()
        if batches:
            return join(batches)
        if self._error is not None:
            self._raise_error()
        return None if self._is_closed else empty_batch()

    def _raise_error(self) -> None:
        """Raise the error and let go of it: through its traceback it holds the queue, and all that reads it."""
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
