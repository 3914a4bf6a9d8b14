"""Messages that could not be used, and why."""

from typing import Final

from clutchdiag_io.pages.content import Cell, Table, moment
from fleet_backend.database import transaction
from fleet_backend.page import wording
from fleet_backend.page.asking import AFTER, LIMIT, Ask
from fleet_backend.page.clutches_view import next_of
from fleet_backend.page.listing import latest_first, page_of
from fleet_backend.page.records import QuarantineAnswer, Quarantined
from fleet_backend.page.view import Shown, Sources, View, list_section
from fleet_backend.schema import QUARANTINE


def find(sources: Sources, ask: Ask) -> QuarantineAnswer:
    """Return a part of what was kept aside."""
    limit = ask.count("limit")
    statement = latest_first(QUARANTINE, "received_at", ("digest",), ask.text("after"), limit)
    with transaction(sources.engine) as connection:
        found = [Quarantined(**row) for row in connection.execute(statement).mappings()]
    some, following = page_of(found, limit, lambda one: (one.received_at.isoformat(), one.digest))
    return QuarantineAnswer(messages=some, next=following)


def show(answer: QuarantineAnswer, ask: Ask, _sources: Sources) -> Shown:
    head = ("received (UTC)", "vehicle", "reason", "detail", "bytes", "begins with", "acknowledged")
    table = Table(
        caption=f"{len(answer.messages)} messages, the latest first",
        head=head,
        rows=tuple(map(_cells, answer.messages)),
    )
    return Shown(
        title="Quarantine",
        subtitle="messages that could not be used; their senders were told",
        sections=(list_section("messages", "Messages", table, "Every message could be used."),),
        next=next_of("/quarantine", ask, answer.next),
    )


def _cells(one: Quarantined) -> tuple[Cell, ...]:
    head = one.head if len(one.head) <= 120 else f"{one.head[:120]}…"
    acknowledged = "" if one.acknowledged_at is None else f"{one.acknowledged_at:%Y-%m-%d} by {one.acknowledged_by}"
    return (
        moment(one.received_at),
        wording.plain(one.vehicle),
        one.reason,
        one.detail,
        str(one.size_bytes),
        wording.plain(head),
        wording.plain(acknowledged),
    )


VIEW: Final = View(
    name="quarantine",
    page_path="/quarantine",
    text="Messages that could not be used, the latest first.",
    parameters=(AFTER, LIMIT),
    answer=QuarantineAnswer,
    find=find,
    show=show,
)
