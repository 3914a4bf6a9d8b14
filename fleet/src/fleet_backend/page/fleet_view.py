"""The overview of the fleet: how many vehicles have which verdict, and each vehicle in one row."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final
from urllib.parse import urlencode

from clutchdiag_io.pages.content import Cell, Link, Table, moment, number
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, LIMIT, Ask, Parameter
from fleet_backend.page.clutches_view import EMPTY, FILTERS, choices, next_of, subtitle, wanted
from fleet_backend.page.listing import Wanted, matching, page_of, place_of, read_words, vehicle_type
from fleet_backend.page.records import ClutchNow, Severity, VehiclesAnswer
from fleet_backend.page.view import Choice, Shown, Sources, View, list_section

ORDERS: Final[Mapping[str, Callable[[ClutchNow], Any]]] = MappingProxyType({
    "vehicle": lambda one: one.vehicle,
    "level": lambda one: 9.0 if one.level_ratio is None else one.level_ratio,
    "km": lambda one: -1.0 if one.odometer_m is None else one.odometer_m,  # who has no odometer is at the low end
    "fluid": lambda one: one.fluid or "",
    "type": vehicle_type,
    "last": lambda one: one.end_at.isoformat(),
})  # fmt: skip
SORTS: Final = (*ORDERS, *(f"-{name}" for name in ORDERS))


def vehicles_of(clutches: Mapping[str, Sequence[ClutchNow]]) -> tuple[ClutchNow, ...]:
    """Return the worse clutch of each vehicle, the worst first; distance, fluid and last event are the vehicle's."""
    return tuple(sorted(map(_vehicle, clutches.values()), key=place_of))


def _vehicle(clutches: Sequence[ClutchNow]) -> ClutchNow:
    worst, last = min(clutches, key=place_of), max(clutches, key=lambda one: one.end_at)
    furthest_m = max((one.odometer_m for one in clutches if one.odometer_m is not None), default=None)
    return replace(worst, odometer_m=furthest_m, fluid=last.fluid, end_at=last.end_at)


def answer_of(
    vehicles: Sequence[ClutchNow], wanted: Wanted, sort: str | None, after: str | None, limit: int
) -> VehiclesAnswer:
    """Return the next vehicles behind the one that ``after`` names, and how many of all have each verdict.

    Raises
    ------
    NotFoundError
        If ``after`` is nothing that an earlier part in this order named.
    """
    found = matching(vehicles, wanted)
    of = None if sort is None else ORDERS[sort.removeprefix("-")]
    key: Callable[[ClutchNow], Any] = place_of if of is None else lambda one: (of(one), one.vehicle)
    is_down = sort is not None and sort.startswith("-")
    rest = found if of is None else sorted(found, key=key)
    if after is not None and rest:
        place = tuple(read_words(after, [type(value) for value in key(rest[0])]))
        rest = [one for one in rest if key(one) < place] if is_down else rest[bisect_right(rest, place, key=key) :]
    some, following = page_of(rest[::-1] if is_down else rest, limit, key)
    counts = Counter(one.condition for one in vehicles)
    return VehiclesAnswer(
        vehicles=some,
        matching_count=len(found),
        vehicle_count=len(vehicles),
        counts={one.value: counts[one.value] for one in Severity},
        next=following,
    )


_SORT: Final = Parameter(name="sort", text="column to sort by, - for downwards; the worst first", choices=SORTS)
_COLUMNS: Final[tuple[tuple[str, str, Callable[[ClutchNow], Cell]], ...]] = (  # head, by which word it sorts, cells
    ("vehicle", "vehicle", lambda one: wording.vehicle_link(one.vehicle)),
    ("verdict", "", lambda one: wording.badge(one.condition)),
    ("what to do", "", lambda one: one.order),
    ("of new", "level", lambda one: wording.share(one.level_ratio)),
    ("last score", "", lambda one: number(one.score, "{:.0f}")),
    ("km", "km", lambda one: wording.km(one.odometer_m)),
    ("fluid", "fluid", lambda one: wording.plain(one.fluid)),
    ("type", "type", vehicle_type),
    ("last event (UTC)", "last", lambda one: moment(one.end_at)),
)
_NAMES: Final = tuple((text, name) for text, name, _ in _COLUMNS)
_ORDERS: Final = (  # for screens that show no heads of columns
    ("", "worst first"),
    *((sign + name, f"{text} {way}") for text, name in _NAMES if name for sign, way in (("", "up"), ("-", "down"))),
)


def find(sources: Sources, ask: Ask) -> VehiclesAnswer:
    snapshot = sources.keeper.snapshot
    vehicles = sources.fleets.of("", snapshot.number, lambda: vehicles_of(snapshot.vehicles))
    return answer_of(vehicles, wanted(ask), ask.text("sort"), ask.text("after"), ask.count("limit"))


def show(answer: VehiclesAnswer, ask: Ask, sources: Sources) -> Shown:
    """Return the page of the fleet."""
    sort = ask.text("sort") or ""
    way = "descending" if sort.startswith("-") else "ascending"
    table = Table(
        caption=f"Vehicles: {answer.matching_count} of {answer.vehicle_count}",
        head=tuple(_head(text, name, ask) for text, name in _NAMES),
        rows=tuple(tuple(cell(one) for *_, cell in _COLUMNS) for one in answer.vehicles),
        sorted_by=([name for _, name in _NAMES].index(sort.removeprefix("-")), way) if sort else None,
    )
    otherwise = "No vehicle matches these filters." if answer.vehicle_count else EMPTY
    title = "In the order of a column" if sort else "Worst first"
    counts = ((one, f"{wording.condition_word(one)}: {count}") for one, count in answer.counts.items() if count)
    return Shown(
        title="Fleet",
        subtitle=subtitle(answer, sources),
        more=tuple(Link(text=text, href=f"/?{urlencode({'condition': one})}") for one, text in counts),
        sections=(list_section("vehicles", title, table, otherwise),),
        choices=(*choices(ask, sources), Choice(name="sort", label="Order", value=sort, options=_ORDERS)),
        next=next_of("/", ask, answer.next),
        follows="",
    )


def _head(text: str, name: str, ask: Ask) -> str | Link:
    """Return the head of a column; it sorts upwards, and downwards where it sorts upwards already."""
    if not name:
        return text
    said = {key: value for key, value in ask.values.items() if key != "after"}
    word = f"-{name}" if ask.text("sort") == name else name
    return Link(text=text, href=f"/?{urlencode({**said, 'sort': word})}")


VIEW: Final = View(
    name="vehicles",
    page_path="/",
    text="Every vehicle as its worse clutch is, the worst first, and how many have each verdict.",
    parameters=(*FILTERS, AFTER, _SORT, LIMIT),
    answer=VehiclesAnswer,
    find=find,
    show=show,
    subtitle=subtitle,
    state=lambda answer: (answer.vehicles, tuple(answer.counts.values()), answer.matching_count, answer.next),
    asks_database=False,
)
