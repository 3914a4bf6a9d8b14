"""The clutches of the fleet, worst first."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final
from urllib.parse import urlencode

from clutchdiag_io.pages.content import Cell, Table, moment, number
from clutchdiag_io.people import PLUS_MINUS, STDS
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, LIMIT, Ask, Parameter
from fleet_backend.page.cache import Same
from fleet_backend.page.listing import Wanted, matching, part_of
from fleet_backend.page.records import ClutchNow, FleetAnswer, Severity
from fleet_backend.page.view import Choice, Shown, Sources, View, list_section

_WANTED: Final = {"q": "name_part", "condition": "condition", "fluid": "fluid", "calibration": "calibration"}
FILTERS: Final = (
    Parameter(name="q", text="a part of the vehicle's name", longest=64),
    Parameter(name="condition", text="verdict", choices=tuple(one.value for one in Severity)),
    Parameter(name="fluid", text="fluid that is in, as it was noted"),
    Parameter(name="calibration", text="calibration of the results, which stands for the type of vehicle"),
)


def wanted(ask: Ask) -> Wanted:
    """Return what the filters of a question look for."""
    return Wanted(**{field: ask.text(name) for name, field in _WANTED.items()})


def find(sources: Sources, ask: Ask) -> FleetAnswer:
    snapshot = sources.keeper.snapshot
    looked_for = wanted(ask)
    after, limit = ask.text("after"), ask.count("limit")
    part = sources.parts.of(
        (looked_for, after, limit),
        snapshot.number,
        lambda: part_of(matching(snapshot.clutches, looked_for), after, limit),
    )
    return FleetAnswer(
        clutches=part.clutches,
        matching_count=part.matching_count,
        clutch_count=len(snapshot.clutches),
        next=part.next,
        read_at=snapshot.read_at,
    )


def show(answer: FleetAnswer, ask: Ask, sources: Sources) -> Shown:
    """Return the page of the clutches."""
    counted = f"{answer.matching_count} of {answer.clutch_count} clutches"
    rows = tuple(tuple(cell(now) for cell in _COLUMNS.values()) for now in answer.clutches)
    table = Table(caption=f"Clutches, worst first: {counted}", head=tuple(_COLUMNS), rows=rows)
    otherwise = "No vehicle matches these filters." if answer.clutch_count else EMPTY
    return Shown(
        title="Clutches",
        subtitle=subtitle(answer, sources),
        sections=(list_section("clutches", "Worst first", table, otherwise),),
        choices=choices(ask, sources),
        next=next_of("/clutches", ask, answer.next),
        follows="",
    )


def next_of(path: str, ask: Ask, after: str | None) -> str | None:
    """Return the address of the next part of a list."""
    if after is None:
        return None
    said = {name: value for name, value in ask.values.items() if name != "after"}
    return f"{path}?{urlencode({**said, 'after': after})}"


EMPTY: Final = "No vehicle has been heard from yet. fleet-backend ingest brings results into this database."
_COLUMNS: Final[Mapping[str, Callable[[ClutchNow], Cell]]] = MappingProxyType({
    "vehicle": lambda now: wording.vehicle_link(now.vehicle),
    "clutch": lambda now: now.element or str(now.clutch),
    "verdict": lambda now: wording.badge(now.condition),
    "what to do": lambda now: now.order,
    "mu_C": lambda now: number(now.mu_c),
    PLUS_MINUS: lambda now: number(now.std_mu_c and STDS * now.std_mu_c),
    "of new": lambda now: wording.share(now.level_ratio),
    "P(falling slope)": lambda now: wording.probability(now.probability_negative_slope),
    "shifts": lambda now: str(now.shift_count),
    "score": lambda now: number(now.score, "{:.0f}"),
    "km": lambda now: wording.km(now.odometer_m),
    "fluid": lambda now: wording.plain(now.fluid),
    "last event (UTC)": lambda now: moment(now.end_at),
})  # fmt: skip


def choices(ask: Ask, sources: Sources) -> tuple[Choice, ...]:
    """Return the filters as a form."""
    snapshot = sources.keeper.snapshot
    conditions = [(one.value, wording.condition_word(one.value)) for one in Severity]
    lists = (
        ("condition", "Verdict", conditions),
        ("fluid", "Fluid", [(one, one) for one in snapshot.fluids]),
        ("calibration", "Type", [(one, one) for one in snapshot.types]),
    )
    return (
        Choice(name="q", label="Vehicle", value=ask.text("q") or ""),
        *(
            Choice(name=name, label=label, value=ask.text(name) or "", options=(("", "any"), *options))
            for name, label, options in lists
        ),
    )


def subtitle(_answer: object, sources: Sources) -> str:
    """Return how many vehicles there are, and when they were read."""
    snapshot = sources.keeper.snapshot
    return f"{len(snapshot.vehicles)} vehicles, read at {snapshot.read_at:%H:%M:%S} UTC"


VIEW: Final = View(
    name="fleet",
    page_path="/clutches",
    text="The running condition of every clutch, the worst first.",
    parameters=(*FILTERS, AFTER, LIMIT),
    answer=FleetAnswer,
    find=find,
    show=show,
    subtitle=subtitle,
    state=lambda answer: (Same(answer.clutches), answer.matching_count, answer.clutch_count, answer.next),
    asks_database=False,
)
