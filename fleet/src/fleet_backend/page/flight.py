"""Answers on their way: bounded in number and in bytes, so that readers who do not read cost neither memory nor others.

uvicorn waits before a write while more than 64 KiB of a connection are unsent, but takes a body of any length at once,
and waits for ever; it has no write timeout (nor has Hypercorn). `server.ReaderInTime` ends connections that stall.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import islice
from typing import Final, TypeVar

import msgspec
from starlette.responses import Response, StreamingResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

RowT = TypeVar("RowT")
PIECE_BYTES: Final = 65_536
MOST_BYTES: Final = 16 * 2**20  # of answers that are whole in memory until they are sent
MOST_STREAMS: Final = 16  # answers that are made while they are sent
MOST_WHOLE: Final = 500  # rows of a list that is not streamed
_ROWS: Final = 100  # of a piece


class NoRoomError(Exception):
    """So much is on its way that nothing can be added: the reader is asked to come again."""


class Room:
    """How much of something may be there at once."""

    def __init__(self, most: int) -> None:
        self._left = most

    @contextmanager
    def taken(self, amount: int) -> Iterator[None]:
        """Take some for as long as the block lasts; raises NoRoomError if there is not enough."""
        if amount > self._left:
            raise NoRoomError
        self._left -= amount
        try:
            yield
        finally:
            self._left += amount


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """Room for what is on its way to all readers."""

    whole: Room = field(default_factory=lambda: Room(MOST_BYTES))
    streamed: Room = field(default_factory=lambda: Room(MOST_STREAMS))


class Pieces:
    """Sends bodies in pieces, each when the one before has left; where there is no room, ``busy`` answers instead."""

    def __init__(self, app: ASGIApp, flight: Flight, busy: Callable[[Scope], Response]) -> None:
        self._app = app
        self._flight = flight
        self._busy = busy

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        start: Message | None = None
        is_refused = False
        with ExitStack() as room:

            async def send_in_pieces(message: Message) -> None:
                nonlocal start, is_refused
                body = message.get("body", b"")
                if message["type"] == "http.response.start":
                    start = message  # goes with the first bytes, when it is known that there is room for them
                    return
                if start is not None:
                    begun, start = start, None
                    try:
                        room.enter_context(self._flight.whole.taken(len(body) if len(body) > PIECE_BYTES else 0))
                    except NoRoomError:
                        is_refused = True
                        await self._busy(scope)(scope, receive, send)
                    else:
                        await send(begun)
                if is_refused:
                    return
                last = max(len(body) - 1, 0) // PIECE_BYTES * PIECE_BYTES
                for begin in range(0, last, PIECE_BYTES):
                    await send({**message, "body": body[begin : begin + PIECE_BYTES], "more_body": True})
                await send({**message, "body": body[last:]})

            await self._app(scope, receive, send_in_pieces)


class Streamed(StreamingResponse):
    """An answer that is made while it is sent."""

    def __init__(
        self, pieces: Iterable[bytes], media_type: str, flight: Flight, busy: Callable[[Scope], Response]
    ) -> None:
        super().__init__(pieces, media_type=media_type)
        self._flight = flight
        self._busy = busy

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it, or that there is no room for it."""
        with ExitStack() as room:
            try:
                room.enter_context(self._flight.streamed.taken(1))
            except NoRoomError:
                await self._busy(scope)(scope, receive, send)
                return
            await super().__call__(scope, receive, send)


def json_pieces(
    answer: Mapping[str, object], name: str, rows: Sequence[RowT], made: Callable[[RowT], object]
) -> Iterator[bytes]:
    """Yield the JSON of an answer and, under a name, of what is made of each row."""
    yield b"{%b:[" % msgspec.json.encode(name)
    for number, piece in enumerate(_grouped(rows)):
        yield (b"," if number else b"") + msgspec.json.encode([made(row) for row in piece])[1:-1]
    yield b"]," + msgspec.json.encode(answer)[1:]


def text_pieces(lines: Iterable[str]) -> Iterator[bytes]:
    """Yield lines as bytes, many at a time."""
    for piece in _grouped(lines):
        yield "".join(piece).encode()


def _grouped(rows: Iterable[RowT]) -> Iterator[list[RowT]]:
    left = iter(rows)
    while piece := list(islice(left, _ROWS)):
        yield piece
