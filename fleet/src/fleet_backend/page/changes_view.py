"""What became different in the fleet since a moment, and why."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any, Final

from sqlalchemy import Connection, func, select

from clutchdiag_io.pages.content import Cell, Table, number
from clutchdiag_io.people import PLUS_MINUS, STDS
from fleet_backend.database import transaction
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, LIMIT, Ask, Parameter, ParameterType
from fleet_backend.page.clutches_view import next_of
from fleet_backend.page.listing import Wanted, matching, part_of
from fleet_backend.page.records import Change, ChangesAnswer, ClutchNow
from fleet_backend.page.view import Choice, Shown, Sources, View, list_section
from fleet_backend.schema import FLUID_FILL, SHIFT_RESULT

Row = Mapping[str, Any]
_COLUMNS: Final = (
    "condition",
    "running_mu_c",
    "running_std_mu_c",
    "algorithm_version",
    "calibration_version",
    "end_at",
)


def _change(connection: Connection, now: ClutchNow, since: datetime) -> Change:
    result, fill = SHIFT_RESULT.c, FLUID_FILL.c
    own = (result.vehicle == now.vehicle, result.clutch == now.clutch)
    order = (result.vehicle, result.clutch, result.produced_at, result.stream, result.seq, result.version_rank)
    last = select(*(result[name] for name in _COLUMNS)).where(*own, result.stored_at < since).limit(1)
    found = connection.execute(last.order_by(*(column.desc() for column in order))).mappings().first()
    before: Row | None = None if found is None else dict(found)
    fresh = select(func.count()).select_from(SHIFT_RESULT).where(*own, result.stored_at >= since)
    count = int(connection.execute(fresh).scalar_one())
    fills: Sequence[str] = ()
    if before is not None:
        between = (fill.vehicle == now.vehicle, fill.filled_at > before["end_at"], fill.filled_at <= now.end_at)
        fills = connection.execute(select(fill.product).where(*between).order_by(fill.filled_at)).scalars().all()
    return Change(
        vehicle=now.vehicle,
        clutch=now.clutch,
        condition_before=None if before is None else before["condition"],
        condition=now.condition,
        mu_c_before=None if before is None else before["running_mu_c"],
        std_mu_c_before=None if before is None else before["running_std_mu_c"],
        mu_c=now.mu_c,
        std_mu_c=now.std_mu_c,
        new_result_count=count,
        why=tuple(_reasons(before, now, count, fills)),
    )


def _reasons(before: Row | None, now: ClutchNow, count: int, fills: Sequence[str]) -> Iterator[str]:
    """Yield why a clutch is told to be another than before, what explains most first."""
    if before is None:
        yield "first results of this clutch"
        return
    for name, word in (("algorithm_version", "algorithm"), ("calibration_version", "calibration")):
        was, is_now = before[name], getattr(now, name)
        if was != is_now:
            yield f"new {word}: {was} before, {is_now} now"
    for product in fills:
        yield f"new fluid: {product}"
    if count:
        yield f"new data: {count} result{'' if count == 1 else 's'}"


USUAL: Final = timedelta(days=7)


def find(sources: Sources, ask: Ask) -> ChangesAnswer:
    """Return a part of what became different."""
    since = ask.moment("since", ask.now - USUAL)
    touched = [now for now in sources.keeper.snapshot.clutches if now.stored_at >= since]
    part = part_of(matching(touched, Wanted(name_part=ask.text("q"))), ask.text("after"), ask.count("limit"))
    with transaction(sources.engine) as connection:
        found = [_change(connection, now, since) for now in part.clutches]
    changes = tuple(one for one in found if one.why)
    return ChangesAnswer(since=since, changes=changes, clutch_count=part.matching_count, next=part.next)


def show(answer: ChangesAnswer, ask: Ask, _sources: Sources) -> Shown:
    head = (
        "vehicle",
        "clutch",
        "verdict before",
        "verdict now",
        "mu_C before",
        PLUS_MINUS,
        "mu_C now",
        PLUS_MINUS,
        "why",
    )
    table = Table(caption="What changed, worst first", head=head, rows=tuple(map(_cells, answer.changes)))
    return Shown(
        title="Changes",
        subtitle=f"since {answer.since:%Y-%m-%d %H:%M} UTC, {answer.clutch_count} clutches with new results",
        sections=(list_section("changes", "What and why", table, "Nothing changed."),),
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
        number(one.mu_c_before),
        number(one.std_mu_c_before and STDS * one.std_mu_c_before),
        number(one.mu_c),
        number(one.std_mu_c and STDS * one.std_mu_c),
        "; ".join(one.why),
    )


VIEW: Final = View(
    name="changes",
    page_path="/changes",
    text="What changed since a given time, and why: new data, another algorithm or calibration, new fluid.",
    parameters=(
        Parameter(name="q", text="a part of the vehicle's name", longest=64),
        Parameter(name="since", text="since when (default: a week ago)", kind=ParameterType.MOMENT, longest=40),
        AFTER,
        LIMIT,
    ),
    answer=ChangesAnswer,
    find=find,
    show=show,
)
