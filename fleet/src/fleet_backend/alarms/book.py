"""The book of alarms: what is raised, cleared and acknowledged, each with the messages that tell of it."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Engine, func, insert, or_, select, update

from fleet_backend.alarms.rules import AlarmEvent, AlarmRule, Subject, Transition
from fleet_backend.database import transaction
from fleet_backend.errors import RowRefusedError
from fleet_backend.office_tables import ALARM, ALARM_MESSAGE, note_change
from fleet_backend.queries import clutch_names

CLAIM: Final = timedelta(seconds=60)  # whoever takes a message has so long to deliver it
_TOGETHER: Final = 500  # in one transaction
_FIRST_PAUSE_S: Final = 2.0
_LONGEST_PAUSE_S: Final = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """Who acknowledges an alarm, and what is to be remembered."""

    by: str
    role: str
    at: datetime
    text: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Letter:
    """A message that waits for a carrier; whoever gets one key twice keeps it once."""

    key: str
    carrier: str
    payload: Mapping[str, Any]
    attempt_count: int


def open_alarms(engine: Engine) -> frozenset[Subject]:
    columns = (ALARM.c.vehicle, ALARM.c.clutch, ALARM.c.rule)
    with transaction(engine) as connection:
        rows = connection.execute(select(*columns).where(ALARM.c.cleared_at.is_(None)))
        return frozenset(Subject(vehicle=row.vehicle, clutch=row.clutch, rule=AlarmRule(row.rule)) for row in rows)


def alarms(
    engine: Engine, *which: ColumnElement[bool], offset: int = 0, limit: int | None = None
) -> list[dict[str, Any]]:
    """Return alarms with the names of their clutches, the latest first; clutch None: of the vehicle as a whole."""
    order = (ALARM.c.raised_at.desc(), ALARM.c.vehicle, ALARM.c.clutch, ALARM.c.rule, ALARM.c.number)
    statement = select(ALARM).where(*which).order_by(*order).offset(offset).limit(limit)
    with transaction(engine) as connection:
        names = clutch_names(connection)
        rows = connection.execute(statement).mappings().all()
    return [
        {**row, "clutch": row["clutch"] or None, "element": names.get((row["vehicle"], row["clutch"]))} for row in rows
    ]


def write(engine: Engine, steps: Iterable[Transition], carriers: Sequence[str]) -> list[Transition]:
    """Write transitions with a message for each carrier; return those that another process had not written already."""
    waiting = list(steps)
    return [
        step
        for first in range(0, len(waiting), _TOGETHER)
        for step in _write(engine, waiting[first : first + _TOGETHER], carriers)
    ]


def acknowledge(engine: Engine, subject: Subject, number: int, note: Note) -> bool:
    """Acknowledge an alarm and note in the audit who did; return whether there was one to acknowledge."""
    waiting = (*_is_of(subject), ALARM.c.number == number, ALARM.c.acknowledged_at.is_(None))
    values: dict[str, Any] = {"acknowledged_at": note.at, "acknowledged_by": note.by, "note": note.text}
    with transaction(engine) as connection:
        count = connection.execute(update(ALARM).where(*waiting).values(**values)).rowcount
        if count:
            text = f"{_key(subject, number)}: {note.text or ''}"
            note_change(connection, "acknowledge alarm", text, at=note.at, by=note.by, role=note.role)
    return count > 0


def acknowledge_open(engine: Engine, vehicle: str, clutch: int, note: Note) -> int:
    """Acknowledge all open alarms of a clutch that nobody has; return how many; clutch 0: the vehicle as a whole."""
    waiting = (ALARM.c.cleared_at.is_(None), ALARM.c.acknowledged_at.is_(None))
    rows = alarms(engine, ALARM.c.vehicle == vehicle, ALARM.c.clutch == clutch, *waiting)
    subjects = ((Subject(vehicle=vehicle, clutch=clutch, rule=AlarmRule(row["rule"])), row["number"]) for row in rows)
    return sum(acknowledge(engine, subject, number, note) for subject, number in subjects)


def claim_letter(engine: Engine, carrier: str, now: datetime) -> Letter | None:
    """Return the message that has waited longest for a carrier, claimed for `CLAIM`; None if none waits."""
    table = ALARM_MESSAGE
    is_free = or_(table.c.claimed_until.is_(None), table.c.claimed_until < now)
    waiting = (table.c.carrier == carrier, table.c.delivered_at.is_(None), table.c.next_try_at <= now, is_free)
    first = select(table.c.key).where(*waiting).order_by(table.c.next_try_at, table.c.key).limit(1).scalar_subquery()
    columns = (table.c.key, table.c.carrier, table.c.payload, table.c.attempt_count)
    claim = update(table).where(table.c.key == first, *waiting).values(claimed_until=now + CLAIM).returning(*columns)
    with transaction(engine) as connection:
        row = connection.execute(claim).mappings().first()
    return None if row is None else Letter(**{**row, "payload": json.loads(row["payload"])})


def note_attempt(engine: Engine, letter: Letter, now: datetime, complaint: str | None) -> None:
    """Note that a message is delivered; with a complaint when it is tried again, which is later each time."""
    pause = timedelta(seconds=min(_FIRST_PAUSE_S * 2.0 ** min(letter.attempt_count, 16), _LONGEST_PAUSE_S))
    values: dict[str, Any] = {"attempt_count": letter.attempt_count + 1, "claimed_until": None, "complaint": complaint}
    values |= {"delivered_at": now} if complaint is None else {"next_try_at": now + pause}
    is_letter = (ALARM_MESSAGE.c.key == letter.key, ALARM_MESSAGE.c.carrier == letter.carrier)
    with transaction(engine) as connection:
        connection.execute(update(ALARM_MESSAGE).where(*is_letter).values(**values))


def _write(engine: Engine, steps: Sequence[Transition], carriers: Sequence[str]) -> list[Transition]:
    try:
        with transaction(engine) as connection:
            numbers = _raise(connection, [step for step in steps if step.event is AlarmEvent.RAISED])
            for step in steps:
                if step.event is AlarmEvent.CLEARED and (number := _clear(connection, step)) is not None:
                    numbers[step] = number
            rows = [
                {
                    "key": f"{_key(step.subject, number)}/{step.event}",
                    "carrier": carrier,
                    "payload": json.dumps(_payload(step, number), sort_keys=True),
                    "made_at": step.at,
                    "next_try_at": step.at,
                }
                for step, number in numbers.items()
                for carrier in carriers
            ]
            if rows:
                connection.execute(insert(ALARM_MESSAGE).values(attempt_count=0), rows)
    except RowRefusedError:  # another process raised one between our look and our word
        middle = len(steps) // 2
        return [*_write(engine, steps[:middle], carriers), *_write(engine, steps[middle:], carriers)] if middle else []
    return list(numbers)


def _raise(connection: Connection, steps: Sequence[Transition]) -> dict[Transition, int]:
    """Return the numbers of new alarms, without those of which one is open."""
    vehicles = {step.subject.vehicle for step in steps}
    subject = (ALARM.c.vehicle, ALARM.c.clutch, ALARM.c.rule)
    open_count_of = func.count() - func.count(ALARM.c.cleared_at)
    counts = select(*subject, func.max(ALARM.c.number), open_count_of).group_by(*subject)
    known = {tuple(row[:3]): row[3:] for row in connection.execute(counts.where(ALARM.c.vehicle.in_(vehicles)))}
    numbers, rows = dict[Transition, int](), []
    for step in steps:
        key = (step.subject.vehicle, step.subject.clutch, step.subject.rule.value)
        last, open_count = known.get(key, (0, 0))
        if not open_count:
            numbers[step] = last + 1
            values = dict(zip(("vehicle", "clutch", "rule"), key, strict=True))
            rows.append(values | {"number": last + 1, "raised_at": step.at, "reason": step.reason})
    if rows:
        connection.execute(insert(ALARM), rows)
    return numbers


def _clear(connection: Connection, step: Transition) -> int | None:
    is_open = (*_is_of(step.subject), ALARM.c.cleared_at.is_(None))
    clear = update(ALARM).where(*is_open).values(cleared_at=step.at).returning(ALARM.c.number)
    number: int | None = connection.scalar(clear)
    return number


def _is_of(subject: Subject) -> tuple[Any, ...]:
    return ALARM.c.vehicle == subject.vehicle, ALARM.c.clutch == subject.clutch, ALARM.c.rule == subject.rule.value


def _key(subject: Subject, number: int) -> str:
    return f"{subject.vehicle}/{subject.clutch}/{subject.rule}/{number}"


def _payload(step: Transition, number: int) -> dict[str, Any]:
    subject = step.subject
    return {
        "alarm": _key(subject, number),
        "event": step.event.value,
        "vehicle": subject.vehicle,
        "clutch": subject.clutch or None,
        "element": subject.element,
        "rule": subject.rule.value,
        "at": step.at.astimezone(UTC).isoformat().replace("+00:00", "Z"),
        "reason": step.reason,
    }
