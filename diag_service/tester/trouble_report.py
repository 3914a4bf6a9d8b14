"""Trouble codes as JSON and as lines for people."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from diag_service.delivery import ControllerNews
from diag_service.tester.description import Value, Values
from diag_service.tester.trouble import Snapshot, TroubleCode

Record = dict[str, object]
NOTHING: Final = "not available"


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerReport(ControllerNews):
    """What a controller said of its trouble codes."""

    vehicle: str
    read_at: str  # ISO 8601 UTC
    controller: str  # where it was asked
    description: str  # what it is taken for
    codes: tuple[TroubleCode, ...]

    def __str__(self) -> str:
        """Return it on a line: the codes that matter, the confirmed ones first."""
        ranked = sorted(self.codes, key=lambda code: not code.is_confirmed)
        return f"controller {self.controller}: {', '.join(map(code_words, ranked)) or 'no trouble codes'}"

    @property
    def record(self) -> Record:
        """The public record that stores and messages hold."""
        return {
            "schema": "clutchdiag/controller/v1",
            "vehicle": self.vehicle,
            "produced_at": self.read_at,
            "controller": self.controller,
            "description": self.description,
            "codes": [trouble_record(code) for code in self.codes],
        }


def code_words(code: TroubleCode) -> str:
    """Return a code with what it says and how sure the controller is."""
    state = "confirmed" if code.is_confirmed else "pending" if code.is_pending else "not confirmed"
    return f"{code.code} {code.text} ({state})" if code.text else f"{code.code} ({state})"


def trouble_record(code: TroubleCode) -> Record:
    """Return a trouble code with what was kept of it."""
    return {
        "code": code.code,
        "failure_type": code.failure_type,
        "number": f"{code.number:06X}",
        "text": code.text,
        "status": code.status,
        "states": list(code.states),
        "snapshots": [_snapshot_record(one) for one in code.snapshots],
        "extended_data": [_snapshot_record(one) for one in code.extended],
    }


def _snapshot_record(snapshot: Snapshot) -> Record:
    data = {name: dict(values) for name, values in snapshot.data.items()}
    return {"number": snapshot.number, "data": data, "rest": snapshot.rest.hex(" ").upper()}


def trouble_lines(codes: Sequence[TroubleCode]) -> Iterator[str]:
    """Yield a line for each code, and under it what was kept."""
    if not codes:
        yield "no trouble codes"
        return
    rows = [
        (code.code, f"{code.failure_type:02X}", f"{code.status:02X}", ", ".join(code.states), code.text)
        for code in codes
    ]
    head, *lines = columns(("code", "type", "status", "state", "text"), rows)
    yield head
    for line, code in zip(lines, codes, strict=True):
        yield line
        yield from _kept_lines("snapshot", code.snapshots)
        yield from _kept_lines("extended data", code.extended)


def _kept_lines(what: str, kept: Iterable[Snapshot]) -> Iterator[str]:
    for one in kept:
        parts = [f"{name}: {values_text(values)}" for name, values in one.data.items()]
        if one.rest:
            parts.append(f"not understood: {one.rest.hex(' ').upper()}")
        yield f"  {what} {one.number:02X}: {'; '.join(parts)}"


def values_text(values: Values) -> str:
    """Return values for people: name, number, unit; the name of one that is alone says nothing new."""
    is_alone = len(values) == 1
    return ", ".join(_value_text("" if is_alone else name, name, value) for name, value in values.items())


def _value_text(shown_name: str, name: str, value: Value) -> str:
    shown = NOTHING if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)
    _, bracket, unit = name.partition(" [")
    unit = f" {unit.removesuffix(']')}" if bracket and value is not None else ""
    return f"{shown_name.partition(' [')[0]} {shown}{unit}".strip()


def columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines, each column as wide as its longest entry."""
    widths = [max(len(row[place]) for row in (head, *rows)) for place in range(len(head))]
    return ["  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip()
            for row in (head, *rows)]  # fmt: skip
