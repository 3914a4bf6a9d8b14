"""Pages that are looked at hear that something is new (server-sent events), and ask for themselves again."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Final

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from fleet_backend.errors import BusyError
from fleet_backend.page.fleet import Keeper
from fleet_backend.page.questions import EventsQuery
from fleet_backend.page.site import asked

PERIOD_S: Final = 5.0  # between two renewals of a page; a line that says nothing finds readers who have gone
MOST_READERS: Final = 500


class News:
    """Tells any number of readers that the snapshot is another; several changes are told as one."""

    def __init__(self, keeper: Keeper, period_s: float = PERIOD_S) -> None:
        self._keeper = keeper
        self._period_s = period_s
        self._reader_count = 0
        self._ended = asyncio.Event()

    def end(self) -> None:
        """Let all readers go; from within the event loop."""
        self._ended.set()

    async def answer(self, request: Request) -> Response:
        """Answer with the events; who comes back says what was heard last.

        Raises
        ------
        BusyError
            If there are too many readers.
        """
        query = asked(request, EventsQuery)
        if self._reader_count >= MOST_READERS:
            raise BusyError(f"{MOST_READERS} readers follow this page already")
        last = request.headers.get("last-event-id", "")
        number = int(last) if last.isascii() and last.isdigit() and len(last) < 20 else query.number
        stream = self.stream(number, query.vehicle)
        return StreamingResponse(stream, media_type="text/event-stream", headers={"x-accel-buffering": "no"})

    async def stream(self, number: int | None, vehicle: str | None) -> AsyncIterator[str]:
        """Yield a message whenever something is new that a reader of the snapshot ``number`` does not know."""
        known = self._now(vehicle) if number in {None, self._keeper.snapshot.number} else None
        self._reader_count += 1
        try:
            yield "retry: 3000\n\n"
            while not self._ended.is_set():
                now, number = self._now(vehicle), self._keeper.snapshot.number
                yield ": still here\n\n" if now == known else f"id: {number}\nevent: news\ndata: {number}\n\n"
                known = now
                with suppress(TimeoutError):
                    async with asyncio.timeout(self._period_s):
                        await self._ended.wait()
        finally:
            self._reader_count -= 1

    def _now(self, vehicle: str | None) -> object:
        snapshot = self._keeper.snapshot
        return snapshot.number if vehicle is None else snapshot.vehicles.get(vehicle, ())
