"""Pages that are looked at hear that something is new (server-sent events), and ask for themselves again."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Final

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from fleet_backend.errors import BusyError
from fleet_backend.page.fleet import Keeper, Snapshot
from fleet_backend.page.questions import EventsQuery
from fleet_backend.page.site import asked

HEARTBEAT_S: Final = 15.0  # a line that says nothing finds readers who have gone
REST_S: Final = 5.0  # between two renewals of a page; results may arrive without end
MOST_READERS: Final = 500


class News:
    """Tells any number of readers that the snapshot is another (server-sent events); several changes as one."""

    def __init__(self, keeper: Keeper, heartbeat_s: float = HEARTBEAT_S, rest_s: float = REST_S) -> None:
        self._keeper = keeper
        self._heartbeat_s = heartbeat_s
        self._rest_s = rest_s
        self._readers: set[asyncio.Event] = set()
        self._ended = asyncio.Event()

    def end(self) -> None:
        """Let all readers go; from within the event loop."""
        self._ended.set()
        for wakes in self._readers:
            wakes.set()

    async def answer(self, request: Request) -> Response:
        """Answer with the events; who comes back says what was heard last."""
        query = asked(request, EventsQuery)
        last = request.headers.get("last-event-id", "")
        number = int(last) if last.isascii() and last.isdigit() and len(last) < 20 else query.number
        stream = self.stream(number, query.vehicle)
        return StreamingResponse(stream, media_type="text/event-stream", headers={"x-accel-buffering": "no"})

    def stream(self, number: int | None, vehicle: str | None) -> AsyncIterator[str]:
        """Return a message whenever something is new that a reader of the snapshot ``number`` does not know.

        Raises
        ------
        BusyError
            If there are too many readers.
        """
        if len(self._readers) >= MOST_READERS:
            raise BusyError(f"{MOST_READERS} readers follow this page already")
        wakes = asyncio.Event()
        if number is not None and number != self._keeper.snapshot.number:
            wakes.set()  # it changed between the page and this question
        return self._messages(wakes, vehicle)

    async def _messages(self, wakes: asyncio.Event, vehicle: str | None) -> AsyncIterator[str]:
        def hear(snapshot: Snapshot) -> None:
            if vehicle is None or vehicle in snapshot.changed:
                wakes.set()

        self._readers.add(wakes)
        leave = self._keeper.listen(hear)
        clock = asyncio.get_running_loop().time
        rested_s = clock() + (0.0 if wakes.is_set() else self._rest_s)  # the page was read just now
        try:
            yield "retry: 3000\n\n"
            while not self._ended.is_set():
                try:
                    async with asyncio.timeout(self._heartbeat_s):
                        await wakes.wait()
                except TimeoutError:
                    yield ": still here\n\n"
                    continue
                with suppress(TimeoutError):
                    async with asyncio.timeout_at(rested_s):
                        await self._ended.wait()
                wakes.clear()
                if not self._ended.is_set():
                    rested_s = clock() + self._rest_s
                    number = self._keeper.snapshot.number
                    yield f"id: {number}\nevent: news\ndata: {number}\n\n"
        finally:
            leave()
            self._readers.discard(wakes)
