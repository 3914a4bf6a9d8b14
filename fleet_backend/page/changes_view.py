"""What became different in the fleet since a moment, and why."""

from datetime import timedelta
from typing import Final

from clutchdiag_io.pages.content import Cell, Section, Table
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, LIMIT, Ask, Kind, Parameter
from fleet_backend.page.changes import changes_of
from fleet_backend.page.fleet_view import next_of
from fleet_backend.page.listing import Wanted, matching, part_of
from fleet_backend.page.records import Change, ChangesAnswer
from fleet_backend.page.view import Choice, Shown, Sources, View

USUAL: Final = timedelta(days=7)


def find(sources: Sources, ask: Ask) -> ChangesAnswer:
    """Return a part of what became different."""
    since = ask.moment("since", ask.now - USUAL)
    touched = [now for now in sources.keeper.snapshot.clutches if now.stored_at >= since]
    part = part_of(matching(touched, Wanted(name_part=ask.text("q"))), ask.text("after"), ask.count("limit"))
    found = changes_of(sources.engine, part.clutches, since)
    changes = tuple(one for one in found if one.why)
    return ChangesAnswer(since=since, changes=changes, clutch_count=part.matching_count, next=part.next)


def show(answer: ChangesAnswer, ask: Ask, _sources: Sources) -> Shown:
    head = ("vehicle", "clutch", "verdict before", "verdict now", "mu_C before", "std", "mu_C now", "std", "why")
    table = Table(caption="What changed, worst first", head=head, rows=tuple(map(_cells, answer.changes)))
    texts = () if answer.changes else ("Nothing changed.",)
    return Shown(
        title="Changes",
        subtitle=f"since {answer.since:%Y-%m-%d %H:%M} UTC, {answer.clutch_count} clutches with new results",
        sections=(
            Section(name="changes", title="What and why", texts=texts, tables=(table,) if answer.changes else ()),
        ),
        choices=(
            Choice(name="q", label="Vehicle", value=ask.text("q") or ""),
            Choice(name="since", label="Since", value=f"{answer.since:%Y-%m-%dT%H:%M}"),
        ),
        next=next_of("/changes", ask, answer.next),
    )


def _cells(one: Change) -> tuple[Cell, ...]:
    return (
        wording.vehicle_link(one.vehicle),
        str(one.clutch),
        wording.plain(None) if one.condition_before is None else wording.badge(one.condition_before),
        wording.badge(one.condition),
        wording.friction(one.mu_c_before),
        wording.friction(one.std_mu_c_before),
        wording.friction(one.mu_c),
        wording.friction(one.std_mu_c),
        "; ".join(one.why),
    )


VIEW: Final = View(
    name="changes",
    page_path="/changes",
    api_path="/api/v1/changes",
    text="What changed since a given time, and why: new data, another algorithm or calibration, new fluid.",
    parameters=(
        Parameter(name="q", text="a part of the vehicle's name", longest=64),
        Parameter(name="since", text="since when (default: a week ago)", kind=Kind.MOMENT, longest=40),
        AFTER,
        LIMIT,
    ),
    answer=ChangesAnswer,
    row=Change,
    find=find,
    show=show,
    rows=lambda answer: answer.changes,
)
