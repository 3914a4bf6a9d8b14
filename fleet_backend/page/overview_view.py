"""The overview of the fleet: how many vehicles have which verdict, and each vehicle in one row."""

from typing import Final
from urllib.parse import urlencode

from clutchdiag_io.pages.content import Cell, Link, Section, Table
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, LIMIT, Ask, Parameter
from fleet_backend.page.fleet_view import EMPTY, FILTERS, choices, next_of, subtitle, wanted
from fleet_backend.page.outlook import type_of
from fleet_backend.page.overview import SORTS, answer_of, vehicles_of
from fleet_backend.page.records import ClutchNow, VehiclesAnswer
from fleet_backend.page.view import Choice, Shown, Sources, View

_SORT: Final = Parameter(name="sort", text="column to sort by, - for downwards; the worst first", choices=SORTS)
_COLUMNS: Final = (
    *(("vehicle", "vehicle"), ("verdict", ""), ("what to do", ""), ("of new", "level"), ("km", "km")),
    *(("fluid", "fluid"), ("type", "type"), ("last event (UTC)", "last")),
)
_ORDERS: Final = (  # for screens that show no heads of columns
    ("", "worst first"),
    *((sign + name, f"{text} {way}") for text, name in _COLUMNS if name for sign, way in (("", "up"), ("-", "down"))),
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
        head=tuple(_head(text, name, ask) for text, name in _COLUMNS),
        rows=tuple(map(_cells, answer.vehicles)),
        sorted_by=([name for _, name in _COLUMNS].index(sort.removeprefix("-")), way) if sort else None,
    )
    texts = () if answer.vehicles else ("No vehicle matches these filters." if answer.vehicle_count else EMPTY,)
    title = "In the order of a column" if sort else "Worst first"
    counts = ((one, f"{wording.condition_word(one)}: {count}") for one, count in answer.counts.items() if count)
    return Shown(
        title="Fleet",
        subtitle=subtitle(answer, sources),
        more=tuple(Link(text=text, href=f"/?{urlencode({'condition': one})}") for one, text in counts),
        sections=(Section(name="vehicles", title=title, texts=texts, tables=(table,) if answer.vehicles else ()),),
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


def _cells(one: ClutchNow) -> tuple[Cell, ...]:
    return (
        wording.vehicle_link(one.vehicle),
        wording.badge(one.condition),
        one.order,
        wording.share(one.level_ratio),
        wording.km(one.odometer_m),
        wording.plain(one.fluid),
        type_of(one.calibration_version),
        wording.minute(one.end_at),
    )


VIEW: Final = View(
    name="vehicles",
    page_path="/",
    api_path="/api/v1/vehicles",
    text="Every vehicle as its worse clutch is, the worst first, and how many have each verdict.",
    parameters=(*FILTERS, AFTER, _SORT, LIMIT),
    answer=VehiclesAnswer,
    row=ClutchNow,
    find=find,
    show=show,
    rows=lambda answer: answer.vehicles,
    subtitle=subtitle,
    state=lambda answer: (answer.vehicles, tuple(answer.counts.values()), answer.matching_count, answer.next),
    asks_database=False,
)
