"""Pages that are looked at hear that something is new (server-sent events), and ask for themselves again."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Final

from fleet_backend.errors import BusyError
from fleet_backend.page.keeper import Keeper, Snapshot

HEARTBEAT_S: Final = 15.0  # a line that says nothing finds readers who have gone
REST_S: Final = 5.0  # between two renewals of a page; results may arrive without end
MOST_READERS: Final = 500


class _Reader:
    """One page that is looked at: whether there is something that it has not heard of."""

    def __init__(self, vehicle: str | None) -> None:
        self._vehicle = vehicle
        self.wakes = asyncio.Event()

    def hear(self, snapshot: Snapshot) -> None:
        """Take note of a snapshot, if it is of interest."""
        if self._vehicle is None or self._vehicle in snapshot.changed:
            self.wakes.set()


class News:
    """Tells any number of readers; one that is slow hears of several changes as one."""

    def __init__(self, keeper: Keeper, heartbeat_s: float = HEARTBEAT_S, rest_s: float = REST_S) -> None:
        self._keeper = keeper
        self._heartbeat_s = heartbeat_s
        self._rest_s = rest_s
        self._readers: set[_Reader] = set()
        self._ended = asyncio.Event()

    def end(self) -> None:
        """Let all readers go; from within the event loop."""
        self._ended.set()
        for reader in self._readers:
            reader.wakes.set()

    def stream(self, number: int | None, vehicle: str | None) -> AsyncIterator[str]:
        """Return a message whenever something is new that a reader of the snapshot ``number`` does not know.

        Raises
        ------
        BusyError
            If there are too many readers.
        """
        if len(self._readers) >= MOST_READERS:
            raise BusyError(f"{MOST_READERS} readers follow this page already")
        reader = _Reader(vehicle)
        if number is not None and number != self._keeper.snapshot.number:
            reader.wakes.set()  # it changed between the page and this question
        return self._messages(reader)

    async def _messages(self, reader: _Reader) -> AsyncIterator[str]:
        self._readers.add(reader)
        leave = self._keeper.listen(reader.hear)
        clock = asyncio.get_running_loop().time
        rested_s = clock() + (0.0 if reader.wakes.is_set() else self._rest_s)  # the page was read just now
        try:
            yield "retry: 3000\n\n"
            while not self._ended.is_set():
                try:
                    async with asyncio.timeout(self._heartbeat_s):
                        await reader.wakes.wait()
                except TimeoutError:
                    yield ": still here\n\n"
                    continue
                with suppress(TimeoutError):
                    async with asyncio.timeout_at(rested_s):
                        await self._ended.wait()
                reader.wakes.clear()
                if not self._ended.is_set():
                    rested_s = clock() + self._rest_s
                    number = self._keeper.snapshot.number
                    yield f"id: {number}\nevent: news\ndata: {number}\n\n"
        finally:
            leave()
            self._readers.discard(reader)
