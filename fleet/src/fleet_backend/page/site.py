"""The web application: host names, login, checked parameters, templates; errors become a page or problem JSON."""

import asyncio
import hmac
import logging
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final, TypeVar
from urllib.parse import parse_qsl, urlencode

import msgspec
from jinja2 import Environment
from sqlalchemy import Engine
from starlette.applications import Starlette
from starlette.authentication import AuthCredentials, AuthenticationBackend, AuthenticationError
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.authentication import AuthenticationMiddleware
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute
from starlette.templating import Jinja2Templates
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from clutchdiag_io.pages.content import templates_of
from fleet_backend.errors import (
    AskError,
    BusyError,
    DatabaseError,
    FleetBackendError,
    ForbiddenError,
    LoginError,
    PageError,
)
from fleet_backend.page import wording
from fleet_backend.page.access import NOBODY, Access, UserRole, Viewer
from fleet_backend.page.fleet import Keeper
from fleet_backend.page.flight import MOST_WHOLE, Flight, Pieces, Streamed, json_pieces

LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
API: Final = "/api/v1"
NAVIGATION: Final = (("/", "Fleet"), ("/maintenance", "Maintenance"), ("/alarms", "Alarms"))
_FORM: Final = "application/x-www-form-urlencoded"
_LONGEST_FORM: Final = 16_384  # bytes
_CONTROLS: Final = re.compile(r"[\x00-\x1f\x7f-\x9f]")  # in no word of an address, whatever stands in its pattern
_FORM_S: Final = 10.0  # for all of its bytes
_JSON: Final = "application/json"
_TOKEN: Final = "token"  # noqa: S105 - the name of a field
_LOG: Final = logging.getLogger(__name__)
QueryT = TypeVar("QueryT")
RowT = TypeVar("RowT")
Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sources:
    """Databases, snapshot and rights by which requests are answered."""

    engine: Engine
    keeper: Keeper
    access: Access = field(default_factory=Access)
    writer: Engine | None = None  # where somebody may change something
    now: Callable[[], datetime] = lambda: datetime.now(UTC)
    flight: Flight = field(default_factory=Flight)


_POLICY: Final = "; ".join(
    (
        *("default-src 'none'", "style-src 'self'", "script-src 'self'", "connect-src 'self'", "img-src 'self'"),
        *("form-action 'self'", "base-uri 'none'", "frame-ancestors 'none'"),
    )
)
SAFE_HEADERS: Final = (
    ("content-security-policy", _POLICY),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
    ("permissions-policy", "camera=(), geolocation=(), microphone=()"),
)


_HOST: Final = re.compile(r"(\[[0-9a-f:.]+\]|[0-9a-z._-]+)(?::[0-9]{0,5})?")  # RFC 9110, 7.2


def host_of(header: str) -> str:
    """Return the name, without a port, by which a header calls the server; empty if it is not exactly a host."""
    match = _HOST.fullmatch(header.casefold())
    return match[1] if match else ""


class Guard:
    """Refuses requests to other host names (DNS rebinding), and adds `SAFE_HEADERS` to every answer.

    Starlette's TrustedHostMiddleware knows no IPv6 addresses.
    """

    def __init__(self, app: ASGIApp, names: Collection[str]) -> None:
        self._app = app
        self._names = frozenset(name.casefold() for name in names)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(dict(SAFE_HEADERS))
                is_static = scope["path"].startswith("/static/")
                headers["cache-control"] = "max-age=3600" if is_static else "no-store"
            await send(message)

        app = self._app
        if scope["type"] == "http" and not self._is_ours(Headers(scope=scope).getlist("host")):
            app = PlainTextResponse("this server has another name\n", status_code=421)
        await app(scope, receive, send_safely)

    def _is_ours(self, hosts: Sequence[str]) -> bool:
        return [host_of(host) in self._names for host in hosts] == [True]


class Login(AuthenticationBackend):
    """Reads the user from the proxy's headers; without a proxy everybody is `NOBODY`, and reads."""

    def __init__(self, access: Access) -> None:
        self._access = access

    async def authenticate(self, conn: HTTPConnection) -> tuple[AuthCredentials, Any]:
        """Return who asks; raises AuthenticationError, from the error that the reader is shown."""
        proxy = self._access.proxy
        names = () if proxy is None else (proxy.user_header, proxy.secret_header)
        try:
            if any(len(conn.headers.getlist(name)) > 1 for name in names):
                raise LoginError("the proxy passed on what somebody else said of the user")
            return AuthCredentials(), self._access.viewer_of(conn.headers)
        except PageError as exc:
            raise AuthenticationError from exc


def application(sources: Sources, routes: list[BaseRoute], lifespan: Lifespan | None = None) -> ASGIApp:
    """Return the application that answers."""
    handlers = dict.fromkeys((FleetBackendError, HTTPException, Exception), _answer_error)
    names = sources.access.host_names or LOOPBACK  # by which readers may call the page
    login = Middleware(
        AuthenticationMiddleware,
        backend=Login(sources.access),
        on_error=lambda conn, exc: _error_answer(conn, exc.__cause__),
    )
    pieces = Middleware(Pieces, flight=sources.flight, busy=_busy)
    inside = Starlette(routes=routes, exception_handlers=handlers, middleware=[pieces, login], lifespan=lifespan)
    inside.state.sources = sources
    for name in _TEMPLATES.env.list_templates(["html"]):
        _TEMPLATES.env.get_template(name)  # the first reader does not wait until it is compiled
    return Guard(inside, names)  # errors get the headers, too


def sources_of(request: HTTPConnection) -> Sources:
    sources: Sources = request.app.state.sources
    return sources


def viewer_of(request: HTTPConnection) -> Viewer:
    viewer: Viewer = request.user
    return viewer


def is_api(request: HTTPConnection) -> bool:
    return request.url.path.startswith(API)


def asked(request: Request, query: type[QueryT]) -> QueryT:
    """Return the parameters of an address as a record; raises AskError.

    An empty one counts as missing on a page, whose forms send the fields that nobody filled in; programs leave it out.
    """
    pairs = [*request.path_params.items(), *request.query_params.multi_items()]
    for name, word in pairs:
        if _CONTROLS.search(f"{name}{word}"):
            raise _no_text(name)
    return _checked(pairs, query, keeps_empty=is_api(request))


async def form_of(request: Request, query: type[QueryT], role: UserRole) -> QueryT:
    """Return the fields of a form as a record.

    Raises
    ------
    ForbiddenError
        If the viewer lacks the role, or the form was not sent by a page of ours: checked by origin and token.
    AskError
        If it is no form, or a field is not valid.
    """
    viewer = viewer_of(request)
    if viewer.role < role:
        raise ForbiddenError(f"this takes the role {role.name.lower()}")
    origin, fetched_by = request.headers.get("origin"), request.headers.get("sec-fetch-site", "same-origin")
    ours = {name.casefold() for name in sources_of(request).access.host_names}
    is_other = origin is not None and host_of(origin.partition("://")[2]) not in ours
    if fetched_by != "same-origin" or is_other:
        raise ForbiddenError("a page of another site sent this request")
    if request.headers.get("content-type", "").partition(";")[0].strip() != _FORM:
        raise AskError(f"a form is sent as {_FORM}")
    if not 0 <= int(request.headers.get("content-length", -1)) <= _LONGEST_FORM:
        raise AskError(f"a form tells its length, of {_LONGEST_FORM} bytes at most")
    try:
        async with asyncio.timeout(_FORM_S):
            content = await request.body()
        words = parse_qsl(content.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=20)
    except (TimeoutError, ClientDisconnect) as exc:
        raise AskError(f"the form did not arrive within {_FORM_S:g} s") from exc
    except ValueError as exc:
        raise AskError("this is not a form") from exc
    token = dict(words).get(_TOKEN, "")
    if not viewer.token or not hmac.compare_digest(viewer.token.encode(), token.encode()):  # of none of our pages
        raise ForbiddenError("this form is no longer valid; open it again")
    pairs = [*request.path_params.items(), *(pair for pair in words if pair[0] != _TOKEN)]
    for name, word in pairs:
        if not f"{name}{word}".replace("\r\n", " ").isprintable():  # a note may have lines
            raise _no_text(name)
    return _checked(pairs, query, keeps_empty=False)


def _no_text(name: str) -> AskError:
    return AskError(f"{ascii(name)[:40]}: holds characters that are not text")


def _checked(pairs: list[tuple[str, str]], query: type[QueryT], *, keeps_empty: bool) -> QueryT:
    """Return words as a record; raises AskError, naming the first that is unknown, said twice, missing or wrong."""
    words = dict(pairs)
    if len(words) < len(pairs):
        raise AskError("a word of this address is given twice")
    try:
        return msgspec.convert({name: word for name, word in pairs if word or keeps_empty}, query, strict=False)
    except msgspec.ValidationError as exc:
        raise AskError(str(exc).replace(" - at `$.", " - at `")) from exc


def encoded(answer: object) -> Response:
    """Return an answer as JSON."""
    return Response(msgspec.json.encode(answer), media_type=_JSON)


def listed(
    request: Request,
    answer: Mapping[str, object],
    name: str,
    rows: Sequence[RowT],
    made: Callable[[RowT], object] = lambda row: row,
) -> Response:
    """Return an answer as JSON, with what is made of rows under a name; a long one is made while it is sent."""
    if len(rows) <= MOST_WHOLE:
        return encoded({name: [made(row) for row in rows], **answer})
    return streamed(request, json_pieces(answer, name, rows, made), _JSON)


def streamed(request: Request, pieces: Iterable[bytes], media_type: str) -> Response:
    """Return an answer that is made while it is sent."""
    return Streamed(pieces, media_type, sources_of(request).flight, _busy)


def _busy(scope: Scope) -> Response:
    return _error_answer(Request(scope), BusyError("Others are slow to read theirs. Ask again in a few seconds."))


def is_known(request: Request, mark: int) -> bool:
    """Return whether the browser already shows this version of a page (``If-None-Match``)."""
    return request.headers.get("if-none-match") == f'"{mark}"'


def page(request: Request, template: str, context: Mapping[str, Any], *, mark: int | None = None) -> Response:
    """Return a page; ``mark``, the version of what it shows, is its ETag, by which an open page renews itself."""
    headers = {} if mark is None else {"etag": f'"{mark}"'}
    return _TEMPLATES.TemplateResponse(request, template, {**context, "mark": mark}, headers=headers)


def _layout_context(request: HTTPConnection) -> dict[str, Any]:
    """Return what the layout of every page shows."""
    sources = sources_of(request)
    query = urlencode([pair for pair in request.query_params.multi_items() if pair[1]])
    path = "/vehicles" if request.url.path == "/" else request.url.path
    return {
        "navigation": NAVIGATION,
        "viewer": request.scope.get("user", NOBODY),
        "complaint": sources.keeper.complaint,
        "snapshot": sources.keeper.snapshot,
        "api_href": f"{API}{path}" + (f"?{query}" if query else ""),
        "is_workshop": sources.writer is not None and request.scope.get("user", NOBODY).role >= UserRole.WORKSHOP,
    }


def _environment() -> Environment:
    environment = templates_of("fleet_backend.page")
    environment.filters |= wording.FILTERS
    environment.globals |= wording.GLOBALS
    return environment


_TEMPLATES: Final = Jinja2Templates(env=_environment(), context_processors=[_layout_context])


async def _answer_error(request: Request, exc: Exception) -> Response:
    return _error_answer(request, exc)


def _error_answer(request: HTTPConnection, exc: BaseException | None) -> Response:
    """Return the page, or the JSON of RFC 9457, that says what is wrong."""
    status, title, detail = _problem(exc)
    headers = {"retry-after": "5"} if status == 503 else {}
    if isinstance(exc, HTTPException) and exc.headers:
        headers |= exc.headers
    if is_api(request):
        content = msgspec.json.encode({"title": title, "status": status, "detail": detail})
        return Response(content, status, headers, media_type="application/problem+json")
    context = {"title": title, "detail": detail, "mark": None}
    return _TEMPLATES.TemplateResponse(Request(request.scope), "problem.html", context, status, headers)


def _problem(exc: BaseException | None) -> tuple[int, str, str]:
    if isinstance(exc, PageError):
        return exc.status, exc.title, str(exc)
    if isinstance(exc, DatabaseError):
        _LOG.warning("%s", exc)
        return 503, "The database does not answer", "The server keeps trying. Load this page again in a few seconds."
    if isinstance(exc, HTTPException):
        return exc.status_code, exc.detail, "The pages there are: " + ", ".join(path for path, _ in NAVIGATION)
    return 500, "This did not work", "The server's log says why."
