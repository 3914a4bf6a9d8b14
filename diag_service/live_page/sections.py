"""What the page of a live run shows: advice on both clutches, the bus, their friction, the last shifts."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from clutchdiag_io.legible import legible
from clutchdiag_io.pages.content import NONE, Advice, Cell, Section, Table, number
from diag_service.diagnosis.summary import frames_line
from diag_service.report.findings import Findings
from diag_service.report.page import advice_of
from diag_service.report.sections import events_section, friction_section, shift_figures
from diag_service.service.onlookers import LiveRun
from diag_service.service.session import versions_for
from diag_service.service.snapshot import Snapshot
from diag_service.store import Row

_MESSAGES_HEAD: Final = ("message", "1/s", "nominal 1/s", "protection", "decoded", "rejected", "missing")


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
    """Return how the bus is, and what comes from it."""
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
