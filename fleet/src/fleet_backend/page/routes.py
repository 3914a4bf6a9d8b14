"""Views and actions as routes: who asks, what for, and what comes back; the role is checked before all else."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cache
from typing import Final
from urllib.parse import parse_qsl, quote, urlencode, urlsplit

import msgspec
from jinja2 import Environment
from markupsafe import Markup
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response, StreamingResponse
from starlette.routing import Route

from clutchdiag_io.pages.content import Link, templates_of
from fleet_backend.errors import AskError, ForbiddenError, LoginError
from fleet_backend.page.access import NOBODY, Access, Role, Viewer, check_role, check_token
from fleet_backend.page.asking import LIMIT, VEHICLE, Ask, Parameter, ParameterType, read_words
from fleet_backend.page.view import Action, Drawn, Shown, Sources, View

NAVIGATION: Final = (
    Link(text="Fleet", href="/"),
    Link(text="Clutches", href="/clutches"),
    Link(text="Alarms", href="/alarms"),
    Link(text="Maintenance", href="/maintenance"),
    Link(text="Changes", href="/changes"),
    Link(text="Quarantine", href="/quarantine"),
)

ASKING: Final = 4  # answers at a time that ask the database: more would wait for each other, and for new connections
THINKING: Final = 2  # likewise that ask none
EVENTS_PATH: Final = "/events"
_FORM: Final = "application/x-www-form-urlencoded"
_MOST_FOR_PROGRAMS: Final = 50_000
_LONGEST_FORM: Final = 16_384  # bytes
_TOKEN: Final = "token"  # noqa: S105 - the name of a field
_EVENT_WORDS: Final = (
    replace(VEHICLE, in_path=False, is_required=False),
    Parameter(name="number", text="of the snapshot that the reader knows", kind=ParameterType.COUNT, least=0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoints:
    """Makes routes that share where answers come from and who may ask."""

    sources: Sources
    access: Access
    now: Callable[[], datetime]
    asking: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(ASKING))
    thinking: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(THINKING))

    def page(self, view: View) -> Route:
        def answer(request: Request) -> Response:
            ask = self._ask(request, view.role, view.parameters)
            number = self.sources.keeper.snapshot.number
            drawn = self._drawn(view, view.find(self.sources, ask), ask)
            words = {name: quote(str(word), safe="") for name, word in request.path_params.items()}
            query = urlencode([pair for pair in request.query_params.multi_items() if pair[1]])
            text = html_of(
                view,
                drawn,
                viewer=ask.viewer,
                api_href=view.api_path.format(**words) + (f"?{query}" if query else ""),
                number=number,
                complaint=self.sources.keeper.complaint,
            )
            return Response(text, media_type="text/html")

        return Route(view.page_path, self._worked_on(view, answer), name=view.name)

    def _drawn(self, view: View, answer: object, ask: Ask) -> Drawn:
        """Return the page of an answer, as it is kept or made anew."""

        def make() -> Drawn:
            shown = view.show(answer, ask, self.sources)
            return Drawn(shown=shown, body=body_of(shown))

        if view.state is None:
            return make()
        key = (view.name, *sorted(ask.values.items()))
        kept = self.sources.pages.of(key, view.state(answer), make)
        return replace(kept, shown=replace(kept.shown, subtitle=view.subtitle(answer, self.sources)))

    def _worked_on(self, view: View, answer: Callable[[Request], Response]) -> Callable[[Request], Awaitable[Response]]:
        """Return what answers in one of few threads; who asks no database does not wait for those who do."""
        turn = self.asking if view.asks_database else self.thinking

        async def answered(request: Request) -> Response:
            async with turn:
                return await run_in_threadpool(answer, request)

        return answered

    def interface(self, view: View) -> Route:
        parameters = api_parameters(view)

        def answer(request: Request) -> Response:
            ask = self._ask(request, view.role, parameters)
            return Response(msgspec.json.encode(view.find(self.sources, ask)), media_type="application/json")

        return Route(view.api_path, self._worked_on(view, answer), name=f"api {view.name}")

    def action(self, action: Action) -> Route:
        """Return the route of a change; only a form of one of our own pages gets through."""

        async def answer(request: Request) -> Response:
            viewer, words = await self._changing(request, action.role)
            ask = read_words(action.parameters, {}, words.items(), self.now(), viewer)
            where = await run_in_threadpool(action.do, self.sources, ask)
            return RedirectResponse(where, status_code=303)

        return Route(action.path, answer, name=action.name, methods=["POST"])

    def events(self) -> Route:
        """Return the route that tells a page that something is new; who comes back says what was heard last."""

        async def answer(request: Request) -> Response:
            viewer = self._viewer(request, Role.VIEWER)
            words = [pair for pair in request.query_params.multi_items() if pair[0] != "number"]
            heard = request.headers.get("last-event-id") or request.query_params.get("number", "")
            ask = read_words(_EVENT_WORDS, {}, [*words, ("number", heard)], self.now(), viewer)
            number = ask.count("number") if ask.text("number") else None
            stream = self.sources.news.stream(number, ask.text("vehicle"))
            return StreamingResponse(stream, media_type="text/event-stream", headers={"x-accel-buffering": "no"})

        return Route(EVENTS_PATH, answer, name="events")

    def document(self, path: str, content: bytes, media_type: str) -> Route:
        """Return the route of a text that does not change."""

        def answer(request: Request) -> Response:
            self._viewer(request, Role.VIEWER)
            return Response(content, media_type=media_type)

        return Route(path, answer, name=path)

    def _viewer(self, request: Request, role: Role) -> Viewer:
        proxy = self.access.proxy
        names = () if proxy is None else (proxy.user_header, proxy.secret_header)
        if any(len(request.headers.getlist(name)) > 1 for name in names):
            raise LoginError("the proxy passed on what somebody else said of the user")
        viewer = self.access.viewer_of(request.headers)
        check_role(viewer, role)
        return viewer

    async def _changing(self, request: Request, role: Role) -> tuple[Viewer, dict[str, str]]:
        """Return who asks for a change by a form of one of our own pages, and its words."""
        viewer = self._viewer(request, role)
        fetched_by = request.headers.get("sec-fetch-site", "same-origin")
        origin = request.headers.get("origin")
        if fetched_by != "same-origin" or (
            origin is not None and urlsplit(origin).hostname not in self.access.host_names
        ):
            raise ForbiddenError("a page of another site sent this request")
        words = dict(await _form_words(request))
        check_token(viewer, words.pop(_TOKEN, ""))
        return viewer, words

    def _ask(self, request: Request, role: Role, parameters: Sequence[Parameter]) -> Ask:
        viewer = self._viewer(request, role)
        return read_words(parameters, request.path_params, request.query_params.multi_items(), self.now(), viewer)


def api_parameters(view: View) -> Sequence[Parameter]:
    """Return what a program may say: as a reader, but for longer parts."""
    return [replace(one, most=_MOST_FOR_PROGRAMS) if one is LIMIT else one for one in view.parameters]


async def _form_words(request: Request) -> list[tuple[str, str]]:
    """Return the words of a form, none of them twice."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != _FORM:
        raise AskError(f"a form is sent as {_FORM}")
    content = b""
    chunks: AsyncIterator[bytes] = request.stream()
    async for chunk in chunks:
        content += chunk
        if len(content) > _LONGEST_FORM:
            raise AskError(f"a form has {_LONGEST_FORM} bytes at most")
    try:
        words = parse_qsl(content.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=20)
    except ValueError as exc:
        raise AskError("this is not a form") from exc
    if len({name for name, _ in words}) != len(words):
        raise AskError("a field of the form is given twice")
    return words


def html_of(view: View, drawn: Drawn, *, viewer: Viewer, api_href: str, number: int, complaint: str | None) -> str:
    """Return the page of an answer.

    Parameters
    ----------
    api_href :
        Address of the same answer for programs.
    viewer :
        Who reads it.
    number :
        Of the snapshot that it is from.
    complaint :
        Why what is shown is older than it should be, if it is.
    """
    return (
        _templates()
        .get_template("view.html")
        .render(
            page=drawn.shown,
            body=drawn.body,
            navigation=NAVIGATION,
            viewer=viewer,
            here=view.page_path,
            api_href=api_href,
            complaint=complaint,
            number=number,
        )
    )


def body_of(shown: Shown) -> Markup:
    """Return the sections of a page, which are the most of it and the same for all readers."""
    return Markup(_templates().get_template("body.html").render(page=shown))  # noqa: S704 - a template escapes


def problem_page(title: str, detail: str) -> str:
    """Return the page of something that went wrong."""
    template = _templates().get_template("problem.html")
    return template.render(title=title, detail=detail, navigation=NAVIGATION, here="", viewer=NOBODY)


@cache
def _templates() -> Environment:
    return templates_of("fleet_backend.page")
