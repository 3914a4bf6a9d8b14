"""One alarm; who may do so acknowledges it here."""

from dataclasses import fields
from typing import Final

from sqlalchemy import Engine, select

from clutchdiag_io.pages.content import Cell, Link, Section, Table
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Note
from fleet_backend.alarms.rules import Rule, Subject
from fleet_backend.database import transaction
from fleet_backend.office_tables import ALARM
from fleet_backend.page import wording
from fleet_backend.page.access import Role
from fleet_backend.page.asking import VEHICLE, Ask, Parameter, ParameterType
from fleet_backend.page.errors import AskError, NotFoundError
from fleet_backend.page.records import Alarm
from fleet_backend.page.view import Action, Field, Form, Shown, Sources, View

_KEY: Final = (
    Parameter(name="vehicle", text=VEHICLE.text, is_required=True, pattern=VEHICLE.pattern, longest=VEHICLE.longest),
    Parameter(name="clutch", text="1 or 2; 0: the vehicle as a whole", choices=("0", "1", "2"), is_required=True),
    Parameter(name="rule", text="what it is about", choices=tuple(one.value for one in Rule), is_required=True),
    Parameter(name="number", text="of the alarm", kind=ParameterType.COUNT, is_required=True),
)
_NOTE: Final = Parameter(name="note", text="what is to be remembered", longest=500)
_NAMES: Final = tuple(field.name for field in fields(Alarm))


def find(sources: Sources, ask: Ask) -> Alarm:
    """Return an alarm; raises NotFoundError if there is none."""
    found = _alarm(sources.engine, _subject(ask), ask.count("number"))
    if found is None:
        raise NotFoundError("there is no such alarm")
    return found


def show(answer: Alarm, ask: Ask, _sources: Sources) -> Shown:
    """Return the page of an alarm, with a form for who may acknowledge it."""
    clutch = "" if answer.clutch is None else f", clutch {answer.clutch}"
    rows: tuple[tuple[Cell, ...], ...] = (
        ("vehicle", wording.vehicle_link(answer.vehicle)),
        ("rule", answer.rule),
        ("reason", answer.reason),
        ("raised (UTC)", wording.minute(answer.raised_at)),
        ("over (UTC)", wording.minute(answer.cleared_at)),
        ("acknowledged (UTC)", wording.minute(answer.acknowledged_at)),
        ("by", wording.plain(answer.acknowledged_by)),
        ("note", wording.plain(answer.note)),
    )
    is_possible = answer.acknowledged_at is None and ask.viewer.role >= Role.WORKSHOP
    return Shown(
        title=f"Alarm {answer.number}: {answer.vehicle}{clutch}: {answer.rule}",
        subtitle=answer.reason,
        sections=(
            Section(name="alarm", title="Alarm", tables=(Table(caption="Facts", head=("what", "value"), rows=rows),)),
        ),
        trail=(Link(text="Alarms", href="/alarms"), wording.vehicle_link(answer.vehicle)),
        form=_form(answer) if is_possible else None,
    )


def acknowledge(sources: Sources, ask: Ask) -> str:
    """Acknowledge an alarm; return the address of what is to be seen then.

    Raises
    ------
    AskError
        If somebody else did so before.
    """
    if sources.writer is None or ask.viewer.name is None:
        raise NotFoundError("this server is read-only")
    find(sources, ask)
    role = ask.viewer.role.name.lower()
    note = Note(by=ask.viewer.name, role=role, at=ask.now, text=ask.text("note"))
    if not book.acknowledge(sources.writer, _subject(ask), ask.count("number"), note):
        raise AskError("somebody else has already acknowledged this alarm")
    return wording.alarm_href(ask.said("vehicle"), int(ask.said("clutch")), ask.said("rule"), ask.count("number"))


def _form(answer: Alarm) -> Form:
    hidden = (
        ("vehicle", answer.vehicle),
        ("clutch", str(answer.clutch or 0)),
        ("rule", answer.rule),
        ("number", str(answer.number)),
    )
    fields_of_it = (Field(name=_NOTE.name, label="Note", longest=_NOTE.longest),)
    return Form(action=ACTION.path, hidden=hidden, fields=fields_of_it, button="Acknowledge")


def _subject(ask: Ask) -> Subject:
    return Subject(vehicle=ask.said("vehicle"), clutch=int(ask.said("clutch")), rule=Rule(ask.said("rule")))


def _alarm(engine: Engine, subject: Subject, number: int) -> Alarm | None:
    own = (ALARM.c.vehicle == subject.vehicle, ALARM.c.clutch == subject.clutch, ALARM.c.rule == subject.rule.value)
    with transaction(engine) as connection:
        row = connection.execute(select(ALARM).where(*own, ALARM.c.number == number)).mappings().first()
    if row is None:
        return None
    return Alarm(**{**{name: row[name] for name in _NAMES}, "clutch": row["clutch"] or None})


VIEW: Final = View(
    name="alarm",
    page_path="/alarm",
    api_path="/api/v1/alarm",
    text="One alarm that a rule raised.",
    parameters=_KEY,
    answer=Alarm,
    row=Alarm,
    find=find,
    show=show,
    rows=lambda answer: [answer],
)
ACTION: Final = Action(
    name="acknowledge",
    path="/alarm/acknowledge",
    text="Acknowledge an alarm.",
    role=Role.WORKSHOP,
    parameters=(*_KEY, _NOTE),
    do=acknowledge,
)
