"""The page of a live run: how the bus is, both clutches, the last shifts; for browsers on the same machine."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from http import HTTPStatus
from importlib import resources
from types import MappingProxyType
from typing import Final
from wsgiref.types import StartResponse, WSGIEnvironment

from jinja2 import Environment

from clutchdiag_io.pages.content import NONE, SAFE_HEADERS, Advice, Cell, Section, Table, host_of, number, templates_of
from clutchdiag_io.program import legible
from diag_service.diagnosis.summary import frames_line
from diag_service.report.findings import Findings
from diag_service.report.page import advice_of, events_section, friction_section, shift_figures
from diag_service.service.onlookers import LiveRun
from diag_service.service.session import versions_for
from diag_service.service.snapshot import Snapshot
from diag_service.service.web import serving_web
from diag_service.settings.config import ListenAddress
from diag_service.store import Row

_MESSAGES_HEAD: Final = ("message", "1/s", "nominal 1/s", "protection", "decoded", "rejected", "missing")
RENEWED_S: Final = 5.0  # rates and counts are shown anew, whatever happens
LOOK_S: Final = 0.5
MOST_READERS: Final = 20
_NAMES: Final = frozenset({"127.0.0.1", "localhost", "[::1]"})
_KEEP: Final = "max-age=3600"
_STATIC: Final[Mapping[str, str]] = MappingProxyType({
    "style.css": "text/css", "live.js": "text/javascript", "icon.svg": "image/svg+xml",
})  # fmt: skip

Answer = Callable[[StartResponse], Iterable[bytes]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """The page at one moment."""

    title: str
    subtitle: str
    number: int  # grows with every shift
    advice: tuple[Advice, ...]
    sections: tuple[Section, ...]


def shown(run: LiveRun) -> Shown:
    """Return the page of a run as it stands."""
    snapshot = run.board.latest
    title = f"Vehicle {legible(run.vehicle)}, live"
    if snapshot is None:
        return Shown(title=title, subtitle="The run begins.", number=0, advice=(), sections=())
    found = _findings(run, snapshot)
    return Shown(
        title=title,
        subtitle=f"{legible(run.source)}; results in {legible(run.store)}",
        number=sum(snapshot.summary.shifts.by_status.values()),
        advice=(advice_of(snapshot.summary.order),),
        sections=(
            bus_section(run, snapshot),
            friction_section(found),
            _shifts_section(run),
            events_section(found),
        ),
    )


def bus_section(run: LiveRun, snapshot: Snapshot) -> Section:
    bus = snapshot.bus
    texts = [] if run.board.is_live else ["The service does not answer: what is shown may be old."]
    if snapshot.stuck is not None:
        texts.append(f"{snapshot.stuck}.")
    errors = ", ".join(f"{count} {error.value.replace('_', ' ')}" for error, count in bus.errors.items())
    facts: tuple[tuple[Cell, ...], ...] = (
        ("state", bus.state.value.replace("_", " ")),
        ("load, stuff bits estimated", number(snapshot.load_ratio, "{:.1%}")),
        ("interruptions", str(bus.interruption_count)),
        ("restarts of the controller", str(bus.restart_count)),
        ("error frames", errors or NONE),
        ("last problem", legible(bus.last_problem or NONE)),
        ("frames", frames_line(snapshot.summary.frames)),
    )
    tables = (
        Table(caption="The bus", head=("what", "value"), rows=facts),
        Table(caption="Messages", head=_MESSAGES_HEAD, rows=tuple(_message_rows(snapshot))),
    )
    return Section(name="bus", title=f"Bus: {bus.state.value.replace('_', ' ')}", texts=tuple(texts), tables=tables)


def _message_rows(snapshot: Snapshot) -> Iterator[tuple[Cell, ...]]:
    for name, counts in snapshot.messages.items():
        yield (
            legible(name),
            number(snapshot.rates_hz[name], "{:.1f}"),
            number(counts.nominal_hz, "{:.1f}"),
            counts.e2e_state.name.lower().replace("_", " "),
            str(counts.decoded),
            str(sum(counts.rejected.values())),
            str(counts.missing),
        )


def _shifts_section(run: LiveRun) -> Section:
    """Return the pictures of the last shifts, the newest first."""
    examples = run.shifts.examples[::-1]
    texts = () if examples else ("No shift yet.",)
    figures = tuple(figure for one in examples for figure in shift_figures(one))
    return Section(name="shifts", title="The last shifts", texts=texts, figures=figures)


def _findings(run: LiveRun, snapshot: Snapshot) -> Findings:
    return Findings(
        vehicle=run.vehicle,
        sources=(run.source,),
        rows=tuple(Row(position=one.seq, result=one) for one in reversed(snapshot.recent)),
        latest=snapshot.clutches,
        versions=versions_for(run.calibration),
        calibration=run.calibration,
        summary=snapshot.summary,
    )


@contextmanager
def opened_page(address: ListenAddress, run: LiveRun) -> Iterator[str]:
    """Show a run while entered; yield the page's address. Raises ConfigError if it cannot be listened to."""
    site = _Site(run)
    with serving_web(address, site.answer, "page") as port:
        try:
            yield f"http://{f'[{address.host}]' if ':' in address.host else address.host}:{port}/"
        finally:
            site.ended.set()


class _Site:
    """Answers requests, each in a thread of its own."""

    def __init__(self, run: LiveRun) -> None:
        self._run = run
        self._free = threading.BoundedSemaphore(MOST_READERS)
        self.ended = threading.Event()

    def answer(self, environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        """Answer one request, of those who call this machine by its own name."""
        if host_of(environ.get("HTTP_HOST", "")) not in _NAMES:
            return _text(start_response, HTTPStatus.MISDIRECTED_REQUEST, "this server has another name\n")
        if environ["REQUEST_METHOD"] not in {"GET", "HEAD"}:
            return _text(start_response, HTTPStatus.METHOD_NOT_ALLOWED, "nothing can be changed here\n")
        path = environ.get("PATH_INFO", "")
        if path == "/":
            return _send(start_response, "text/html; charset=utf-8", page_text(self._run).encode())
        if path == "/events":
            return self._events(start_response)
        name = path.removeprefix("/static/")
        if path.startswith("/static/") and name in _STATIC:
            return _send(start_response, _STATIC[name], _file(name), cache_control=_KEEP)
        return _text(start_response, HTTPStatus.NOT_FOUND, "the page is at /\n")

    def _events(self, start_response: StartResponse) -> Iterable[bytes]:
        if not self._free.acquire(blocking=False):
            return _text(start_response, HTTPStatus.SERVICE_UNAVAILABLE, "too many readers\n")
        try:
            start_response("200 OK", _headers("text/event-stream", "no-store"))
        except BaseException:
            self._free.release()
            raise
        return self._news()

    def _news(self) -> Iterator[bytes]:
        """Yield a message whenever a shift came or the bus changed, and otherwise now and then."""
        try:
            yield b"retry: 3000\n\n"
            known, told_s = self._state(), time.monotonic()
            while not self.ended.wait(LOOK_S):
                state, now_s = self._state(), time.monotonic()
                if state != known or now_s - told_s >= RENEWED_S:
                    known, told_s = state, now_s
                    yield b"event: news\ndata: 1\n\n"
        finally:
            self._free.release()

    def _state(self) -> object:
        latest = self._run.board.latest
        if latest is None:
            return None
        return latest.summary.shifts, latest.bus.state, latest.stuck, latest.fluid, self._run.board.is_live


def page_text(run: LiveRun) -> str:
    return _templates().get_template("live.html").render(page=shown(run))


def _send(
    start_response: StartResponse, kind: str, content: bytes, *, cache_control: str = "no-store"
) -> Iterable[bytes]:
    start_response("200 OK", [*_headers(kind, cache_control), ("content-length", str(len(content)))])
    return [content]


def _text(start_response: StartResponse, status: HTTPStatus, text: str) -> Iterable[bytes]:
    start_response(f"{status.value} {status.phrase}", _headers("text/plain; charset=utf-8", "no-store"))
    return [text.encode()]


def _headers(kind: str, cache_control: str) -> list[tuple[str, str]]:
    return [("content-type", kind), ("cache-control", cache_control), *SAFE_HEADERS]


@cache
def _templates() -> Environment:
    return templates_of("diag_service.report")


@cache
def _file(name: str) -> bytes:
    return resources.files("clutchdiag_io.pages").joinpath("templates").joinpath(name).read_bytes()
