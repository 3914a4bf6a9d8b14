"""How numbers, moments and verdicts of the fleet read: filters of the templates, and addresses of pages."""

from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, date, datetime
from functools import partial
from types import MappingProxyType
from typing import Any, Final
from urllib.parse import quote, urlencode

from markupsafe import Markup, escape

from clutch_model.units import degc_from_k
from clutch_results.prognosis.sentence import at_least
from clutch_results.shift_course import COURSE_HEAD, course_row, load_line
from clutchdiag_io.pages.content import NONE, number
from clutchdiag_io.people import PLUS_MINUS, STDS, moment_words
from fleet_backend.ageing.records import Severity
from fleet_contract.orders import SHOWN_AS, Action, cause_words, title_of

M_PER_KM: Final = 1000.0
LONG_TEXT: Final = 30  # letters


def td(name: str, value: object, tag: str = "td") -> Markup:
    """Return a cell of a table; a narrow screen shows its name beside it, and a long text below that."""
    is_wide = isinstance(value, str) and len(value) > LONG_TEXT and "<" not in value
    style = ' class="wide"' if is_wide else ""
    # A page has hundreds of cells, and Markup.format and macros of Jinja take ten times as long.
    return Markup(f'<{tag} data-name="{escape(name)}"{style}>{escape(value)}</{tag[:2]}>')  # noqa: S704


def half_width(std: float | None, scale: float = 1.0) -> Markup | str:
    """Return what stands behind ±."""
    return number(None if std is None else STDS * std, scale=scale)


def moment(at: datetime | date | None, form: str = "%Y-%m-%d %H:%M") -> Markup | str:
    """Return a moment in UTC or a day, all of it for programs; a dash where there is none."""
    if at is None:
        return NONE
    if not isinstance(at, datetime):
        return Markup('<time datetime="{0}">{0}</time>').format(at.isoformat())
    return Markup(f'<time datetime="{at.astimezone(UTC).isoformat()}">{moment_words(at, form)}</time>')  # noqa: S704


def badge(condition: str | None) -> Markup | str:
    """Return the word of a verdict, whose style adds a sign and a colour."""
    if condition is None:
        return NONE
    form = Markup('<span class="{}"><strong class="badge">{}</strong></span>')
    return form.format(style(condition), words(condition))


def style(condition: str) -> str:
    return condition.replace("_", "-")


def words(word: str | Iterable[str] | None) -> str:
    """Return what programs write with underscores as people read it."""
    if word is None or isinstance(word, str):
        return (word or NONE).replace("_", " ")
    return ", ".join(part.replace("_", " ") for part in word) or NONE


def shown_as(action: str) -> str:
    """Return the verdict as which an order is shown."""
    return SHOWN_AS[Action(action)]


def address(path: str, **query: object) -> str:
    """Return the address of a page; empty parameters are left out."""
    parameters = {name: value for name, value in query.items() if value not in (None, "")}
    return f"{quote(path)}?{urlencode(parameters)}" if parameters else quote(path)


def degc(temperature_k: float | None) -> Markup | str:
    return number(None if temperature_k is None else degc_from_k(temperature_k), "{:.1f}")


# What somebody does next, by the order for the vehicle.
_DRIVE: Final = "Drive 20 gear changes of each clutch with a warm gearbox, then look here again."
STEPS: Final[Mapping[Action, tuple[str, ...]]] = MappingProxyType({
    Action.CHANGE_NOW: ("Change the fluid.", "Note it: product, date and odometer.", _DRIVE),
    Action.CHANGE_AT_SERVICE: ("Order the fluid.", "Change it at the next service.", "Note it.", _DRIVE),
    Action.FIND_CAUSE: ("See to the likeliest cause.", _DRIVE),
    Action.NEW_FLUID: (_DRIVE,),
    Action.MEASURE_AGAIN: (_DRIVE,),
})  # fmt: skip
NOTHING_YET: Final = "No vehicle has been heard from yet. fleet-backend ingest brings results into this database."
GLOBALS: Final[Mapping[str, object]] = MappingProxyType({
    "address": address,
    "td": td,
    "th": partial(td, tag='th scope="row"'),
    "title_of": title_of,
    "pairs": lambda words_of: [(word, word) for word in words_of],
    "course_head": COURSE_HEAD,
    "plus_minus": PLUS_MINUS,
    "conditions": [(severity.value, words(severity.value)) for severity in Severity],
    "nothing_yet": NOTHING_YET,
})  # fmt: skip
FILTERS: Final[Mapping[str, Callable[..., Any]]] = MappingProxyType({
    "number": number,
    "half": half_width,
    "km": lambda distance_m: number(distance_m, "{:,.0f}", 1.0 / M_PER_KM),
    "at_least": at_least,
    "share": lambda value: number(value, "{:.1%}"),
    "moment": moment,
    "badge": badge,
    "style": style,
    "words": words,
    "shown_as": shown_as,
    "cause": lambda likely: cause_words(likely.cause, likely.clutch),
    "course_row": course_row,
    "load_line": load_line,
    "degc": degc,
    "some": lambda text: escape(text) if text not in (None, "") else NONE,
})  # fmt: skip
