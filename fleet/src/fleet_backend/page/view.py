"""What a view is: one question, answered for people as a page and for programs as JSON."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, Final

from markupsafe import Markup
from sqlalchemy import Engine

from clutchdiag_io.pages.content import Advice, Link, Section, Table
from fleet_backend.page.access import Role
from fleet_backend.page.asking import Ask, Parameter
from fleet_backend.page.cache import Cache
from fleet_backend.page.keeper import Keeper
from fleet_backend.page.listing import Part
from fleet_backend.page.news import News
from fleet_backend.page.outlook import Past
from fleet_backend.page.records import ClutchNow, Due, VehicleAnswer

MOST_POINTS: Final = 60_000  # of trends that are kept, a kilobyte each
MOST_PARTS: Final = 200_000  # clutches in lists that are kept, eight bytes each
MOST_LETTERS: Final = 20_000_000  # of pages that are kept, two bytes each


@dataclass(frozen=True, slots=True, kw_only=True)
class Sources:
    """Where answers come from."""

    engine: Engine
    keeper: Keeper
    news: News
    writer: Engine | None = None  # where somebody may change something
    pasts: Cache[Past] = field(default_factory=lambda: Cache(MOST_POINTS, lambda one: len(one.trend)))
    vehicles: Cache[VehicleAnswer] = field(default_factory=lambda: Cache(MOST_POINTS, _points))
    parts: Cache[Part] = field(default_factory=lambda: Cache(MOST_PARTS, lambda one: len(one.clutches)))
    fleets: Cache[tuple[ClutchNow, ...]] = field(default_factory=lambda: Cache(0, len))  # one
    dues: Cache[tuple[Due, ...]] = field(default_factory=lambda: Cache(0, len))  # one
    pages: "Cache[Drawn]" = field(default_factory=lambda: Cache(MOST_LETTERS, lambda one: len(one.body)))


def _points(answer: VehicleAnswer) -> int:
    return sum(len(one.trend) for one in answer.clutches)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A field of a form that filters: a text to type, or one of some values."""

    name: str
    label: str
    value: str
    options: tuple[tuple[str, str], ...] = ()  # value and words; empty: to type


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A text that somebody types."""

    name: str
    label: str
    longest: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """What somebody may change here."""

    action: str
    hidden: tuple[tuple[str, str], ...]
    fields: tuple[Field, ...]
    button: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """An answer as a page shows it."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]
    advice: tuple[Advice, ...] = ()
    trail: tuple[Link, ...] = ()  # pages above this one
    more: tuple[Link, ...] = ()  # other pages on the same
    choices: tuple[Choice, ...] = ()
    next: str | None = None  # of a list
    form: Form | None = None
    follows: str | None = None  # is renewed when something of it is new; empty: of any


def list_section(name: str, title: str, table: Table, otherwise: str) -> Section:
    """Return a table under its title; where it has no rows what is said instead."""
    texts, tables = ((), (table,)) if table.rows else ((otherwise,), ())
    return Section(name=name, title=title, texts=texts, tables=tables)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A page, and its sections as HTML."""

    shown: Shown
    body: Markup


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A question that can be asked.

    Parameters
    ----------
    find, show :
        What answers it; how the answer looks.
    answer :
        The record that ``find`` returns.
    state :
        Of an answer: while it stays the same, so does the page, its subtitle apart; None: pages are not kept.
    """

    name: str
    page_path: str
    text: str
    parameters: tuple[Parameter, ...]
    answer: type
    find: Callable[[Sources, Ask], Any]
    show: Callable[[Any, Ask, Sources], Shown]
    role: Role = Role.VIEWER  # the least that may ask
    subtitle: Callable[[Any, Sources], str] = lambda _answer, _sources: ""  # of a page that is kept
    state: Callable[[Any], Hashable] | None = None
    asks_database: bool = True

    @property
    def api_path(self) -> str:
        """The address of the answer for programs."""
        return f"/api/v1{'/vehicles' if self.page_path == '/' else self.page_path}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """Something that can be changed, by a form of one of our pages.

    Parameters
    ----------
    do :
        Changes it, and returns the address of what is to be seen then.
    """

    name: str
    path: str
    text: str
    role: Role
    parameters: tuple[Parameter, ...]
    do: Callable[[Sources, Ask], str]
