"""The site: views become routes for people and for programs; whatever goes wrong becomes one line and a status."""

import logging
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from datetime import datetime
from importlib import resources
from types import MappingProxyType
from typing import Final
from urllib.parse import quote, urlencode

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp

from fleet_backend.errors import DatabaseError, FleetBackendError
from fleet_backend.page import alarms_view, changes_view, fleet_view, quarantine_view, shift_view, vehicle_view
from fleet_backend.page.asking import LIMIT, VEHICLE, Kind, Parameter, read_words
from fleet_backend.page.description import FORMAT, Problem, openapi
from fleet_backend.page.errors import PageError
from fleet_backend.page.files import MEDIA_TYPES, Format, file_of, json_of
from fleet_backend.page.headers import KnownHosts, SafeHeaders
from fleet_backend.page.html import NAVIGATION, html_of, problem_page
from fleet_backend.page.view import Sources, View

VIEWS: Final = (
    *(fleet_view.VIEW, vehicle_view.VIEW, shift_view.VIEW),
    *(alarms_view.VIEW, changes_view.VIEW, quarantine_view.VIEW),
)
EVENTS_PATH: Final = "/events"
OPENAPI_PATH: Final = "/api/v1/openapi.json"
_API: Final = "/api/"
_MOST_IN_A_FILE: Final = 50_000
_STATIC_TYPES: Final[Mapping[str, str]] = MappingProxyType(
    {"css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
)
_EVENT_WORDS: Final = (
    replace(VEHICLE, in_path=False, is_required=False),
    Parameter(name="number", text="of the snapshot that the reader knows", kind=Kind.COUNT, least=0),
)
_LOG: Final = logging.getLogger(__name__)

Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]


def site(
    sources: Sources, *, host_names: Collection[str], lifespan: Lifespan | None = None, now: Callable[[], datetime]
) -> ASGIApp:
    """Return the application that answers; ``host_names`` are those by which readers may call it."""
    routes = [route for view in VIEWS for route in (_page_route(view, sources, now), _api_route(view, sources, now))]
    description = json_of(openapi([(view, _api_parameters(view)) for view in VIEWS]))
    routes += [
        Route(OPENAPI_PATH, lambda _: Response(description, media_type="application/json"), name="openapi"),
        Route(EVENTS_PATH, _events_endpoint(sources, now), name="events"),
        Route("/static/{name}", _static_endpoint(), name="static"),
    ]
    handlers = dict.fromkeys((FleetBackendError, HTTPException, Exception), _tell)
    inside = Starlette(routes=routes, exception_handlers=handlers, lifespan=lifespan)
    return SafeHeaders(KnownHosts(inside, host_names))  # around everything, what goes wrong included


def _page_route(view: View, sources: Sources, now: Callable[[], datetime]) -> Route:
    def answer(request: Request) -> Response:
        ask = read_words(view.parameters, request.path_params, request.query_params.multi_items(), now())
        number = sources.keeper.snapshot.number
        found = view.find(sources, ask)
        shown = view.show(found, ask, sources)
        complaint = sources.keeper.complaint
        text = html_of(view, shown, api_href=_api_href(view, request), number=number, complaint=complaint)
        return Response(text, media_type="text/html")

    return Route(view.page_path, answer, name=view.name)


def _api_route(view: View, sources: Sources, now: Callable[[], datetime]) -> Route:
    parameters = _api_parameters(view)

    def answer(request: Request) -> Response:
        ask = read_words(parameters, request.path_params, request.query_params.multi_items(), now())
        form = Format(ask.text(FORMAT.name) or Format.JSON)
        found = view.find(sources, ask)
        if form is Format.JSON:
            return Response(json_of(found), media_type=MEDIA_TYPES[form])
        name = f'attachment; filename="{view.name}.{form}"'
        body = file_of(form, view.rows(found), view.row)
        return Response(body, media_type=MEDIA_TYPES[form], headers={"content-disposition": name})

    return Route(view.api_path, answer, name=f"api {view.name}")


def _events_endpoint(
    sources: Sources, now: Callable[[], datetime]
) -> Callable[[Request], Coroutine[object, object, Response]]:
    """Return what tells a page that something is new; a browser that comes back says what it heard last."""

    async def answer(request: Request) -> Response:
        words = [pair for pair in request.query_params.multi_items() if pair[0] != "number"]
        heard = request.headers.get("last-event-id") or request.query_params.get("number", "")
        ask = read_words(_EVENT_WORDS, {}, [*words, ("number", heard)], now())
        number = ask.count("number") if ask.text("number") else None
        stream = sources.news.stream(number, ask.text("vehicle"))
        return StreamingResponse(stream, media_type="text/event-stream", headers={"x-accel-buffering": "no"})

    return answer


def _api_href(view: View, request: Request) -> str:
    path = view.api_path.format(**{name: quote(str(word), safe="") for name, word in request.path_params.items()})
    query = urlencode([pair for pair in request.query_params.multi_items() if pair[1]])
    return f"{path}?{query}" if query else path


def _api_parameters(view: View) -> Sequence[Parameter]:
    """Return what a program may say: longer parts, and how the answer is written."""
    return [*(replace(one, most=_MOST_IN_A_FILE) if one is LIMIT else one for one in view.parameters), FORMAT]


def _static_endpoint() -> Callable[[Request], Response]:
    files = {entry.name: entry.read_bytes() for entry in _static_entries()}

    def answer(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in files:
            raise HTTPException(404)
        kind = _STATIC_TYPES[name.rpartition(".")[2]]
        return Response(files[name], media_type=kind, headers={"cache-control": "max-age=3600"})

    return answer


def _static_entries() -> list[resources.abc.Traversable]:
    own = [one for one in resources.files("fleet_backend.page").joinpath("static").iterdir() if one.is_file()]
    return [*own, resources.files("program_io.pages").joinpath("templates").joinpath("style.css")]


async def _tell(request: Request, exc: Exception) -> Response:
    """Return what a reader is told instead of an answer."""
    status, title, detail = _problem(exc)
    headers = {"retry-after": "5"} if status == 503 else {}
    if isinstance(exc, HTTPException) and exc.headers:
        headers |= exc.headers
    if request.url.path.startswith(_API):
        content = Problem(title=title, status=status, detail=detail)
        return Response(json_of(content), status, headers, media_type="application/problem+json")
    return Response(problem_page(title, detail), status, headers, media_type="text/html")


def _problem(exc: Exception) -> tuple[int, str, str]:
    if isinstance(exc, PageError):
        return exc.status, exc.title, str(exc)
    if isinstance(exc, DatabaseError):
        _LOG.warning("%s", exc)
        return 503, "The database does not answer", "It is tried again; so may you, in a few seconds."
    if isinstance(exc, HTTPException):
        return exc.status_code, exc.detail, "The pages there are: " + ", ".join(link.href for link in NAVIGATION)
    return 500, "This did not work", "The server's log says why."
