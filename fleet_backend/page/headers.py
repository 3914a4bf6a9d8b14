"""What stands around every answer: safe headers, and only those who call the server by its own name."""

from collections.abc import Collection
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from clutchdiag_io.pages.headers import SAFE_HEADERS, host_of

_KEEP_NOTHING: Final = "no-store"  # of what says something of vehicles


class SafeHeaders:
    """Puts the headers on every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SAFE_HEADERS:
                    headers[name] = value
                headers.setdefault("cache-control", _KEEP_NOTHING)
            await send(message)

        await self._app(scope, receive, send_safely)


class KnownHosts:
    """Answers those who call this server by its own names; a strange page that leads its name here gets nothing."""

    def __init__(self, app: ASGIApp, names: Collection[str]) -> None:
        self._app = app
        self._names = frozenset(name.casefold() for name in names)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "http" and host_of(Headers(scope=scope).get("host", "")) not in self._names:
            await PlainTextResponse("this server has another name\n", status_code=421)(scope, receive, send)
            return
        await self._app(scope, receive, send)
