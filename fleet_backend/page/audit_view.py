"""Who changed what."""

from typing import Final

from clutchdiag_io.pages.content import Table, moment
from fleet_backend.database import transaction
from fleet_backend.office_tables import AUDIT
from fleet_backend.page.access import Role
from fleet_backend.page.asking import AFTER, LIMIT, Ask
from fleet_backend.page.clutches_view import next_of
from fleet_backend.page.listing import latest_first, page_of
from fleet_backend.page.records import AuditAnswer, AuditEntry
from fleet_backend.page.view import Shown, Sources, View, list_section


def find(sources: Sources, ask: Ask) -> AuditAnswer:
    """Return a part of the audit, the latest first."""
    limit = ask.count("limit")
    statement = latest_first(AUDIT, "at", ("audit_id",), ask.text("after"), limit)
    with transaction(sources.engine) as connection:
        found = tuple(AuditEntry(**row) for row in connection.execute(statement).mappings())
    some, following = page_of(found, limit, lambda one: (one.at.isoformat(), one.audit_id))
    return AuditAnswer(entries=some, next=following)


def show(answer: AuditAnswer, ask: Ask, _sources: Sources) -> Shown:
    rows = tuple((moment(one.at), one.who, one.role, one.action, one.subject) for one in answer.entries)
    table = Table(caption="Changes, the latest first", head=("at (UTC)", "who", "role", "did", "what"), rows=rows)
    return Shown(
        title="Audit",
        subtitle="who changed what",
        sections=(list_section("audit", "Changes by people", table, "Nobody changed anything."),),
        next=next_of("/audit", ask, answer.next),
    )


VIEW: Final = View(
    name="audit",
    page_path="/audit",
    text="Who changed what, the latest first.",
    parameters=(AFTER, LIMIT),
    answer=AuditAnswer,
    row=AuditEntry,
    find=find,
    show=show,
    rows=lambda answer: answer.entries,
    role=Role.ADMIN,
)
