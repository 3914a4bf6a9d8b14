"""How vehicles shift that cannot tell friction: their stored events by kind and gears, and what changed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Engine

from clutch_results.measures import MEASURES, Measure
from clutch_results.records import ShiftEstimate, Tier
from clutch_results.shifting import (
    CHANGE_LEGEND,
    OverallChange,
    ShiftingRow,
    ShiftingSummary,
    ShiftingValue,
    change_cell,
    shifting_of,
    shifting_record,
    unknown_friction_words,
)
from clutchdiag_io.pages.content import NONE
from clutchdiag_io.people import PLUS_MINUS
from fleet_backend.ageing.prognosis import BEYOND_NUMBERS, estimate_of, result_in
from fleet_backend.ageing.records import ClutchNow
from fleet_backend.ageing.results import in_order, results_of
from fleet_backend.queries import Row

NOT_YET: Final = "Friction: cannot be known from this car; shifting: not worked out yet"


def summary_of(rows: Sequence[Row], estimates: Sequence[ShiftEstimate]) -> ShiftingSummary | None:
    """Return how a vehicle shifts by the events that tell no friction; None if there is none, or no number can be."""
    estimate_by_row = {id(row): estimate for row, estimate in zip(rows, estimates, strict=True)}
    told = [row for row in rows if estimate_by_row[id(row)].tier is not Tier.FRICTION]
    try:
        summary = shifting_of(result_in(row, estimate_by_row[id(row)]) for row in in_order(told))
    except BEYOND_NUMBERS:
        return None
    return summary if summary.event_count else None


def words_of(engine: Engine, clutches: Sequence[ClutchNow]) -> str | None:
    """Read the past of a vehicle, and return how it shifts in one sentence; None: nothing is known of it."""
    rows = [row for now in clutches for row in results_of(engine, now.vehicle, now.clutch)]
    summary = summary_of(rows, list(map(estimate_of, rows)))
    return None if summary is None else unknown_friction_words(summary)


def answer_of(summary: ShiftingSummary) -> dict[str, Any]:
    """Return how a vehicle shifts as pages and programs read it."""
    return {"text": unknown_friction_words(summary), **shifting_record(summary)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftingTable:
    """What is known of the shifting of a vehicle, for people: heads, and rows of texts."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def shifting_tables(summary: ShiftingSummary) -> list[ShiftingTable]:
    """Return the events of a vehicle by kind and gears, then what changed of them; a dash is what is not measured."""
    keys = {value.key for row in summary.rows for value in row.values}
    measures = [measure for measure in MEASURES if measure.key in keys]
    heads = (f"{measure.name} [{measure.unit}]" if measure.unit else measure.name for measure in measures)
    drives = f"{summary.event_count} events in {summary.drive_count} drives"
    means = ShiftingTable(
        caption=f"By kind and gears, mean {PLUS_MINUS}: {drives}",
        heads=("event", "events", *heads),
        rows=tuple(
            (row.name, str(row.event_count), *(_mean(row, measure) for measure in measures)) for row in summary.rows
        ),
    )
    overall = {change.key: change for change in summary.overall}
    changed: list[tuple[str, Sequence[ShiftingValue | OverallChange | None]]] = [
        ("all events", [overall.get(measure.key) for measure in measures]),
        *((row.name, [row.value(measure) for measure in measures]) for row in summary.rows),
    ]
    told = [(name, [change_cell(summary, value) for value in values]) for name, values in changed]
    since = "since the first drive" if summary.drive_count > 1 else "over the drive"
    trend = ShiftingTable(
        caption=f"What changed {since}, {PLUS_MINUS}; {CHANGE_LEGEND}",
        heads=("event", *(measure.name for measure in measures)),
        rows=tuple((name, *(NONE if text == "-" else text for text in texts)) for name, texts in told),
    )
    return [means, trend]


def _mean(row: ShiftingRow, measure: Measure) -> str:
    value = row.value(measure)
    return NONE if value is None else measure.number(value.mean, value.std)
