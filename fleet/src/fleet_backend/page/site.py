"""The site: views become routes for people and for programs; whatever goes wrong becomes one line and a status."""

import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from datetime import datetime
from importlib import resources
from importlib.metadata import version
from types import MappingProxyType
from typing import Any, Final

import msgspec
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from clutchdiag_io.pages.content import SAFE_HEADERS, host_of
from fleet_backend.errors import DatabaseError, FleetBackendError, PageError
from fleet_backend.page import (
    alarms_view,
    changes_view,
    clutches_view,
    fleet_view,
    maintenance_view,
    quarantine_view,
    shift_view,
    vehicle_view,
)
from fleet_backend.page.access import Access
from fleet_backend.page.asking import TEXT, Parameter, ParameterType
from fleet_backend.page.routes import NAVIGATION, Endpoints, api_parameters, problem_page
from fleet_backend.page.view import Sources, View

_REF: Final = "#/components/schemas/{name}"
_KEEP_NOTHING: Final = "no-store"  # of what says something of vehicles


class SafeHeaders:
    """Puts the headers on every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
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
        if scope["type"] == "http" and host_of(Headers(scope=scope).get("host", "")) not in self._names:
            await PlainTextResponse("this server has another name\n", status_code=421)(scope, receive, send)
            return
        await self._app(scope, receive, send)


class Problem(msgspec.Struct, frozen=True, kw_only=True):
    """What went wrong (RFC 9457)."""

    title: str
    status: int
    detail: str


def openapi(views: Sequence[tuple[View, Sequence[Parameter]]]) -> dict[str, Any]:
    records = [view.answer for view, _ in views]
    schemas, components = msgspec.json.schema_components([*records, Problem], ref_template=_REF)
    problem = schemas[-1]
    paths = {
        view.api_path: {"get": _operation(view, parameters, schema, problem)}
        for (view, parameters), schema in zip(views, schemas, strict=False)
    }
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "clutchdiag fleet",
            "version": version("clutchdiag"),
            "description": "What the fleet's database knows. SI units, UTC. Within v1 keys are only ever added.",
        },
        "paths": paths,
        "components": {"schemas": components},
    }


def _operation(view: View, parameters: Iterable[Parameter], schema: object, problem: object) -> dict[str, Any]:
    content = {"application/json": {"schema": schema}}
    wrong = {"content": {"application/problem+json": {"schema": problem}}}
    answers = {
        "200": {"description": view.text, "content": content},
        "400": {"description": "the request is not valid", **wrong},
        "401": {"description": "nobody is logged in", **wrong},
        "403": {"description": f"this takes the role {view.role.name.lower()}", **wrong},
        "404": {"description": "not found", **wrong},
        "503": {"description": "the database does not answer", **wrong},
    }
    return {
        "operationId": view.name,
        "summary": view.text,
        "parameters": [_parameter(one) for one in parameters],
        "responses": answers,
    }


def _parameter(one: Parameter) -> dict[str, Any]:
    described: dict[str, Any] = {
        "name": one.name,
        "in": "path" if one.in_path else "query",
        "required": one.is_required,
        "description": one.text,
        "schema": _schema(one),
    }
    may_be_empty = not one.in_path and not one.is_required  # as an empty field of a form: not said
    return {**described, "allowEmptyValue": True} if may_be_empty else described


def _schema(one: Parameter) -> dict[str, Any]:
    if one.kind is ParameterType.COUNT:
        limits: dict[str, Any] = {"type": "integer", "minimum": one.least, "maximum": one.most}
        return limits if one.default is None else {**limits, "default": one.default}
    schema: dict[str, Any] = {"type": "string", "maxLength": one.longest}
    if one.kind is ParameterType.MOMENT:
        schema["format"] = "date-time"
    if one.choices:
        schema["enum"] = list(one.choices)
    if one.pattern is not None:
        schema["pattern"] = f"^{one.pattern}$"
    elif one.kind is ParameterType.TEXT and not one.choices:
        schema["pattern"] = f"^{TEXT}$"
    return schema


VIEWS: Final = (
    *(fleet_view.VIEW, clutches_view.VIEW, vehicle_view.VIEW, shift_view.VIEW),
    *(alarms_view.VIEW, alarms_view.ONE_VIEW, maintenance_view.VIEW, changes_view.VIEW),
    quarantine_view.VIEW,
)
ACTIONS: Final = (alarms_view.ACTION,)
OPENAPI_PATH: Final = "/api/v1/openapi.json"
LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
_API: Final = "/api/"
_STATIC_TYPES: Final[Mapping[str, str]] = MappingProxyType({
    "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml",
})  # fmt: skip
_LOG: Final = logging.getLogger(__name__)

Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]


def site(sources: Sources, access: Access, *, lifespan: Lifespan | None = None, now: Callable[[], datetime]) -> ASGIApp:
    """Return the application that answers."""
    make = Endpoints(sources=sources, access=access, now=now)
    description = msgspec.json.encode(openapi([(view, api_parameters(view)) for view in VIEWS]))
    routes = [
        *(make.page(view) for view in VIEWS),
        *(make.interface(view) for view in VIEWS),
        *(make.action(action) for action in ACTIONS),
        make.document(OPENAPI_PATH, description, "application/json"),
        make.events(),
        Route("/static/{name}", _static_endpoint(), name="static"),
    ]
    handlers = dict.fromkeys((FleetBackendError, HTTPException, Exception), _tell)
    inside = Starlette(routes=routes, exception_handlers=handlers, lifespan=lifespan)
    return SafeHeaders(KnownHosts(inside, host_names(access)))  # around everything, what goes wrong included


def host_names(access: Access) -> Collection[str]:
    """Return the names by which readers may call the page: the loopback's, or those that are given instead."""
    return access.host_names or LOOPBACK


def _static_endpoint() -> Callable[[Request], Response]:
    own = [one for one in resources.files("fleet_backend.page").joinpath("static").iterdir() if one.is_file()]
    folder = resources.files("clutchdiag_io.pages").joinpath("templates")
    shared = (folder.joinpath(name) for name in ("style.css", "live.js", "times.js", "icon.svg"))
    files = {entry.name: entry.read_bytes() for entry in (*own, *shared)}

    def answer(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in files:
            raise HTTPException(404)
        kind = _STATIC_TYPES[name.rpartition(".")[2]]
        return Response(files[name], media_type=kind, headers={"cache-control": "max-age=3600"})

    return answer


async def _tell(request: Request, exc: Exception) -> Response:
    """Return what a reader is told instead of an answer."""
    status, title, detail = _problem(exc)
    headers = {"retry-after": "5"} if status == 503 else {}
    if isinstance(exc, HTTPException) and exc.headers:
        headers |= exc.headers
    if request.url.path.startswith(_API):
        content = Problem(title=title, status=status, detail=detail)
        return Response(msgspec.json.encode(content), status, headers, media_type="application/problem+json")
    return Response(problem_page(title, detail), status, headers, media_type="text/html")


def _problem(exc: Exception) -> tuple[int, str, str]:
    if isinstance(exc, PageError):
        return exc.status, exc.title, str(exc)
    if isinstance(exc, DatabaseError):
        _LOG.warning("%s", exc)
        return 503, "The database does not answer", "The server keeps trying. Load this page again in a few seconds."
    if isinstance(exc, HTTPException):
        return exc.status_code, exc.detail, "The pages there are: " + ", ".join(link.href for link in NAVIGATION)
    return 500, "This did not work", "The server's log says why."
