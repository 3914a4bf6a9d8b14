"""The overview of the fleet: how many vehicles have which verdict, and each vehicle in one row."""

from typing import Final
from urllib.parse import urlencode

from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, LIMIT, Ask, Parameter
from fleet_backend.page.fleet_view import EMPTY, FILTERS, choices, next_of, subtitle, wanted
from fleet_backend.page.overview import SORTS, answer_of, vehicles_of
from fleet_backend.page.records import VehicleNow, VehiclesAnswer
from fleet_backend.page.remembered import Same
from fleet_backend.page.view import Choice, Shown, Sources, View
from program_io.pages.content import Cell, Link, Section, Table

_SORT: Final = Parameter(name="sort", text="column to sort by, - for downwards; the worst first", choices=SORTS)
_COLUMNS: Final = (
    *(("vehicle", "vehicle"), ("verdict", ""), ("what to do", ""), ("of new", "level"), ("km", "km")),
    *(("fluid", "fluid"), ("type", "type"), ("last event (UTC)", "last")),
)
_WORST: Final = ("", "worst first")


def find(sources: Sources, ask: Ask) -> VehiclesAnswer:
    """Return the vehicles that are asked for."""
    snapshot, looked_for = sources.keeper.snapshot, wanted(ask)
    sort, after, limit = ask.text("sort"), ask.text("after"), ask.count("limit")
    vehicles = sources.fleets.of("", snapshot.number, lambda: vehicles_of(snapshot.vehicles))
    return sources.overviews.of(
        (looked_for, sort, after, limit),
        snapshot.number,
        lambda: answer_of(vehicles, looked_for, sort, after, limit),
    )


def show(answer: VehiclesAnswer, ask: Ask, sources: Sources) -> Shown:
    """Return the page of the fleet."""
    caption = f"Vehicles: {answer.matching_count} of {answer.vehicle_count}"
    table = Table(
        caption=caption,
        head=tuple(_head(text, name, ask) for text, name in _COLUMNS),
        rows=tuple(map(_cells, answer.vehicles)),
        sorted_by=_sorted_by(ask),
    )
    texts = () if answer.vehicles else ("No vehicle fits these filters." if answer.vehicle_count else EMPTY,)
    title = "In the order of a column" if ask.text("sort") else "Worst first"
    return Shown(
        title="Fleet",
        subtitle=subtitle(answer, sources),
        more=tuple(_count(condition, count) for condition, count in answer.counts.items() if count),
        sections=(Section(name="vehicles", title=title, texts=texts, tables=(table,) if answer.vehicles else ()),),
        choices=(
            *choices(ask, sources),
            Choice(name="sort", label="Order", value=ask.text("sort") or "", options=_options()),
        ),
        next=next_of("/", ask, answer.next),
        follows="",
    )


def _count(condition: str, count: int) -> Link:
    return Link(text=f"{wording.condition_word(condition)}: {count}", href=f"/?{urlencode({'condition': condition})}")


def _head(text: str, name: str, ask: Ask) -> str | Link:
    """Return the head of a column; it sorts upwards, and downwards where it sorts upwards already."""
    if not name:
        return text
    said = {key: value for key, value in ask.values.items() if key != "after"}
    word = f"-{name}" if ask.text("sort") == name else name
    return Link(text=text, href=f"/?{urlencode({**said, 'sort': word})}")


def _sorted_by(ask: Ask) -> tuple[int, str] | None:
    sort = ask.text("sort")
    if sort is None:
        return None
    place = [name for _, name in _COLUMNS].index(sort.removeprefix("-"))
    return place, "descending" if sort.startswith("-") else "ascending"


def _options() -> tuple[tuple[str, str], ...]:
    """Return the orders as a list, for screens that show no heads of columns."""
    columns = [(name, text) for text, name in _COLUMNS if name]
    return (_WORST, *((f"{sign}{name}", f"{text} {way}") for name, text in columns for sign, way in _WAYS))


_WAYS: Final = (("", "upwards"), ("-", "downwards"))


def _cells(one: VehicleNow) -> tuple[Cell, ...]:
    return (
        wording.vehicle_link(one.vehicle),
        wording.badge(one.condition),
        wording.remark(one),
        wording.share(one.level_ratio),
        wording.km(one.odometer_m),
        wording.plain(one.fluid),
        one.calibration_version,
        wording.minute(one.end_at),
    )


VIEW: Final = View(
    name="vehicles",
    page_path="/",
    api_path="/api/v1/vehicles",
    text="Every vehicle as its worse clutch is, the worst first, and how many have each verdict.",
    parameters=(*FILTERS, AFTER, _SORT, LIMIT),
    answer=VehiclesAnswer,
    row=VehicleNow,
    find=find,
    show=show,
    rows=lambda answer: answer.vehicles,
    subtitle=subtitle,
    state=Same,
    asks_database=False,
)
