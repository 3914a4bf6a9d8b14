"""Alarms that rules raised, open ones first asked for, and one of them; who may do so acknowledges it here."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Final

from sqlalchemy import RowMapping, select

from clutchdiag_io.pages.content import Cell, Link, Section, Table, moment
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Note
from fleet_backend.alarms.rules import Rule, Subject
from fleet_backend.database import transaction
from fleet_backend.errors import AskError, NotFoundError
from fleet_backend.office_tables import ALARM
from fleet_backend.page import wording
from fleet_backend.page.access import Role
from fleet_backend.page.asking import AFTER, LIMIT, VEHICLE, Ask, Parameter, ParameterType
from fleet_backend.page.clutches_view import next_of
from fleet_backend.page.listing import latest_first, page_of
from fleet_backend.page.records import Alarm, AlarmsAnswer
from fleet_backend.page.view import Action, Choice, Field, Form, Shown, Sources, View, list_section
from fleet_backend.queries import clutch_names
from fleet_contract.orders import name_of

_KEY: Final = ("vehicle", "clutch", "rule", "number")
_STATES: Final = ("open", "waiting", "all")
_STATE_WORDS: Final = (("", "open"), ("waiting", "open, not acknowledged"), ("all", "all"))
_NAMES: Final = tuple(field.name for field in fields(Alarm) if field.name != "element")


def find(sources: Sources, ask: Ask) -> AlarmsAnswer:
    """Return a part of the alarms."""
    limit, state, rule = ask.count("limit"), ask.text("state"), ask.text("rule")
    statement = latest_first(ALARM, "raised_at", _KEY, ask.text("after"), limit)
    if state != "all":
        statement = statement.where(ALARM.c.cleared_at.is_(None))
    if state == "waiting":
        statement = statement.where(ALARM.c.acknowledged_at.is_(None))
    if rule is not None:
        statement = statement.where(ALARM.c.rule == rule)
    with transaction(sources.engine) as connection:
        names = clutch_names(connection)
        found = [_alarm(row, names) for row in connection.execute(statement).mappings()]
    some, following = page_of(found, limit, _place)
    return AlarmsAnswer(alarms=some, next=following)


def _place(one: Alarm) -> tuple[object, ...]:
    return one.raised_at.isoformat(), one.vehicle, one.clutch or 0, one.rule, one.number


def show(answer: AlarmsAnswer, ask: Ask, _sources: Sources) -> Shown:
    head = ("vehicle", "clutch", "rule", "raised (UTC)", "over (UTC)", "reason", "acknowledged", "note")
    table = Table(
        caption=f"{len(answer.alarms)} alarms, the latest first", head=head, rows=tuple(map(_cells, answer.alarms))
    )
    otherwise = "No alarms. fleet-backend watch raises them while it runs."
    rules = (("", "any"), *((one.value, one.value) for one in Rule))
    return Shown(
        title="Alarms",
        subtitle="raised by rules; only one alarm per vehicle and rule is open at a time",
        sections=(list_section("alarms", "Alarms", table, otherwise),),
        choices=(
            Choice(name="state", label="State", value=ask.text("state") or "", options=_STATE_WORDS),
            Choice(name="rule", label="Rule", value=ask.text("rule") or "", options=rules),
        ),
        next=next_of("/alarms", ask, answer.next),
    )


def _alarm(row: RowMapping, names: Mapping[tuple[str, int], str]) -> Alarm:
    values = {name: row[name] for name in _NAMES} | {"clutch": row["clutch"] or None}
    return Alarm(**values, element=names.get((row["vehicle"], row["clutch"])))


def _cells(one: Alarm) -> tuple[Cell, ...]:
    at = one.acknowledged_at
    return (
        wording.vehicle_link(one.vehicle),
        wording.plain(None if one.clutch is None else one.element or str(one.clutch)),
        Link(text=one.rule, href=wording.alarm_href(one.vehicle, one.clutch or 0, one.rule, one.number)),
        moment(one.raised_at),
        moment(one.cleared_at),
        one.reason,
        wording.plain(None if at is None else f"{at:%Y-%m-%d %H:%M} by {one.acknowledged_by}"),
        wording.plain(one.note),
    )


VIEW: Final = View(
    name="alarms",
    page_path="/alarms",
    text="Alarms that rules raised, the latest first.",
    parameters=(
        Parameter(name="state", text="which ones (default: open)", choices=_STATES),
        Parameter(name="rule", text="what they are about", choices=tuple(one.value for one in Rule)),
        AFTER,
        LIMIT,
    ),
    answer=AlarmsAnswer,
    find=find,
    show=show,
)

_ONE: Final = (
    Parameter(name="vehicle", text=VEHICLE.text, is_required=True, pattern=VEHICLE.pattern, longest=VEHICLE.longest),
    Parameter(name="clutch", text="1 or 2; 0: the vehicle as a whole", choices=("0", "1", "2"), is_required=True),
    Parameter(name="rule", text="what it is about", choices=tuple(one.value for one in Rule), is_required=True),
    Parameter(name="number", text="of the alarm", kind=ParameterType.COUNT, is_required=True),
)
_NOTE: Final = Parameter(name="note", text="what is to be remembered", longest=500)


def find_one(sources: Sources, ask: Ask) -> Alarm:
    """Return an alarm; raises NotFoundError if there is none."""
    own = (ALARM.c.vehicle == ask.said("vehicle"), ALARM.c.clutch == int(ask.said("clutch")))
    is_it = (*own, ALARM.c.rule == ask.said("rule"), ALARM.c.number == ask.count("number"))
    with transaction(sources.engine) as connection:
        row = connection.execute(select(ALARM).where(*is_it)).mappings().first()
        if row is None:
            raise NotFoundError("there is no such alarm")
        return _alarm(row, clutch_names(connection))


def show_one(answer: Alarm, ask: Ask, _sources: Sources) -> Shown:
    """Return the page of an alarm, with a form for who may acknowledge it."""
    clutch = "" if answer.clutch is None else f", {name_of(answer.clutch, answer.element)}"
    rows: tuple[tuple[Cell, ...], ...] = (
        ("vehicle", wording.vehicle_link(answer.vehicle)),
        ("rule", answer.rule),
        ("reason", answer.reason),
        ("raised (UTC)", moment(answer.raised_at)),
        ("over (UTC)", moment(answer.cleared_at)),
        ("acknowledged (UTC)", moment(answer.acknowledged_at)),
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
    find_one(sources, ask)
    role = ask.viewer.role.name.lower()
    note = Note(by=ask.viewer.name, role=role, at=ask.now, text=ask.text("note"))
    subject = Subject(vehicle=ask.said("vehicle"), clutch=int(ask.said("clutch")), rule=Rule(ask.said("rule")))
    if not book.acknowledge(sources.writer, subject, ask.count("number"), note):
        raise AskError("somebody else has already acknowledged this alarm")
    return wording.alarm_href(subject.vehicle, subject.clutch, subject.rule, ask.count("number"))


def _form(answer: Alarm) -> Form:
    hidden = (
        ("vehicle", answer.vehicle),
        ("clutch", str(answer.clutch or 0)),
        ("rule", answer.rule),
        ("number", str(answer.number)),
    )
    fields_of_it = (Field(name=_NOTE.name, label="Note", longest=_NOTE.longest),)
    return Form(action=ACTION.path, hidden=hidden, fields=fields_of_it, button="Acknowledge")


ONE_VIEW: Final = View(
    name="alarm",
    page_path="/alarm",
    text="One alarm that a rule raised.",
    parameters=_ONE,
    answer=Alarm,
    find=find_one,
    show=show_one,
)
ACTION: Final = Action(
    name="acknowledge",
    path="/alarm/acknowledge",
    text="Acknowledge an alarm.",
    role=Role.WORKSHOP,
    parameters=(*_ONE, _NOTE),
    do=acknowledge,
)
