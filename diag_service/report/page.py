"""A report as one HTML file: written whole or not at all, it loads nothing and runs nothing."""

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

from canlog.whole_file import replacing
from clutchdiag_io.legible import legible, legible_record
from clutchdiag_io.pages.content import Advice, Section, Table
from clutchdiag_io.pages.environment import templates_of
from diag_service.diagnosis.results import SHIFT_SCHEMA, clutch_record, order_record, shift_record, utc_from_bus_ns
from diag_service.diagnosis.summary import capability_line, frames_line, gaps_line, summary_record, values_line
from diag_service.errors import StoreError
from diag_service.report.findings import Findings
from diag_service.report.sections import (
    events_section,
    friction_section,
    quality_section,
    shifts_section,
    trend_section,
)
from fleet_contract import CLUTCHES, JsonObject
from fleet_contract.orders import SHOWN_AS, Order

REPORT_SCHEMA: Final = "clutchdiag/report/v1"
_PACKAGE: Final = "diag_service.report"


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A whole report."""

    title: str
    subtitle: str
    advice: tuple[Advice, ...]
    sections: tuple[Section, ...]
    record: object  # the same for programs, as JSON has it


def page_of(found: Findings, made_at: str) -> Page:
    """Return the page of a report; ``made_at`` is the present moment (ISO 8601 UTC)."""
    sections = (
        friction_section(found),
        trend_section(found),
        shifts_section(found),
        quality_section(found),
        _unseen_section(found),
        events_section(found),
        _versions_section(found, made_at),
    )
    return Page(
        title=f"Clutches of {found.vehicle}",
        subtitle=_subtitle(found),
        advice=(advice_of(found.order),),
        sections=sections,
        record=legible_record(record_of(found)),
    )


def record_of(found: Findings) -> JsonObject:
    """Return what the page says in numbers, as `analyze --json` tells it."""
    return {
        "schema": REPORT_SCHEMA,
        "vehicle": found.vehicle,
        **order_record(found.order),
        "clutches": [clutch_record(shift_record(result), found.order) for result in found.latest],
        "summary": None if found.summary is None else summary_record(found.summary),
    }


def html_of(page: Page) -> str:
    """Return a page as HTML."""
    return templates_of(_PACKAGE).get_template("report.html").render(page=page)


def write_page(path: Path, page: Page) -> int:
    """Write a page and return its size in bytes; raises StoreError if the disk does not take it."""
    content = html_of(page).encode("utf-8", "backslashreplace")
    with replacing(path, StoreError) as part:
        part.write_bytes(content)
        part.replace(path)
    return len(content)


def advice_of(order: Order) -> Advice:
    """Return the order for a vehicle, as a page shows it."""
    condition = SHOWN_AS[order.action]
    return Advice(condition=condition.replace("_", "-"), word=condition.replace("_", " "), text=order.text)


def _subtitle(found: Findings) -> str:
    names = ", ".join(legible(name) for name in found.sources)
    if not found.rows:
        return f"no event in {names}"
    first, last = found.rows[0].result.estimate, found.rows[-1].result.estimate
    days = dict.fromkeys((_day(first.start_ns), _day(last.end_ns)))  # one of them twice is one
    return f"{len(found.rows)} events, {' to '.join(days)}, from {names}"


def _day(t_ns: int) -> str:
    return utc_from_bus_ns(t_ns)[:10]


def _unseen_section(found: Findings) -> Section:
    """Return what was not seen and why, and what became of the frames."""
    texts = [f"Clutch {clutch}: no event engaged it." for clutch in CLUTCHES if clutch not in _engaged(found)]
    if found.left_out_count:
        texts.append(f"{found.left_out_count} results of other algorithms or calibrations are left out.")
    summary = found.summary
    if summary is not None:
        lines = (gaps_line(summary.gaps), capability_line(summary), values_line(summary.frames))
        texts += [line for line in (*lines, *map(legible, summary.contributions.idle)) if line]
        if summary.capability.unseen and capability_line(summary) == "":
            texts.append(f"mapped, but never seen: {', '.join(summary.capability.unseen)}")
        texts.append(f"On the bus: {frames_line(summary.frames)}.")
    else:
        texts.append("A store keeps only results. The report of a log tells what happened to its frames.")
    return Section(name="unseen", title="What was not seen, and why", texts=tuple(texts))


def _engaged(found: Findings) -> set[int]:
    return {result.estimate.clutch for result in found.results}


def _versions_section(found: Findings, made_at: str) -> Section:
    rows = (
        ("program", f"clutchdiag {version('clutchdiag')}"),
        ("algorithm", found.versions.algorithm),
        ("calibration", found.versions.calibration),
        ("results", SHIFT_SCHEMA),
        ("made at (UTC)", made_at[:19].replace("T", " ")),
    )
    table = Table(caption="Versions", head=("what", "version"), rows=rows)
    return Section(name="versions", title="Versions", tables=(table,))
