"""Trouble codes from answers of service 19 (ISO 14229-1, annex D), as JSON and as lines for people."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from clutchdiag_io.people import digits
from diag_service.errors import MalformedAnswerError
from workshop.tester.answers import EXTENDED, HEAD_BYTES, ROW_BYTES, SNAPSHOTS, hex_text
from workshop.tester.description import Description, Values, code_text, read_fields

CODE_BYTES: Final = ROW_BYTES - 1
STATUS_BITS: Final = (
    "failed",
    "failed this cycle",
    "pending",
    "confirmed",
    "not tested since clear",
    "failed since clear",
    "not tested this cycle",
    "lamp on",
)
PENDING_BIT: Final = 0x04
CONFIRMED_BIT: Final = 0x08


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureRecord:
    """Data of a failure: a snapshot, or a record of extended data."""

    number: int
    data: Mapping[str, Values]  # by the name of the datum
    rest: bytes = b""  # bytes that the description cannot decode


@dataclass(frozen=True, slots=True, kw_only=True)
class TroubleCode:
    """A trouble code with its snapshots and extended data."""

    number: int  # three bytes: the code and its failure type
    status: int
    text: str = ""
    snapshots: tuple[FailureRecord, ...] = field(default=())
    extended: tuple[FailureRecord, ...] = field(default=())
    fault: str = ""  # why snapshots or extended data are missing

    @property
    def code(self) -> str:
        """The code, such as P0811."""
        return code_text(self.number)

    @property
    def failure_type(self) -> int:
        """The third byte."""
        return self.number & 0xFF

    @property
    def states(self) -> tuple[str, ...]:
        """The set status bits, in words."""
        return tuple(word for bit, word in enumerate(STATUS_BITS) if self.status >> bit & 1)

    @property
    def is_confirmed(self) -> bool:
        return bool(self.status & CONFIRMED_BIT)

    @property
    def is_pending(self) -> bool:
        """Whether the code is pending and not confirmed."""
        return bool(self.status & PENDING_BIT) and not self.is_confirmed


def read_codes(response: bytes, description: Description) -> tuple[TroubleCode, ...]:
    """Return the codes in a valid response; zeros at the end are padding."""
    content = response[HEAD_BYTES[response[1]] :]
    codes = []
    for place in range(0, len(content), ROW_BYTES):
        number = int.from_bytes(content[place : place + CODE_BYTES], "big")
        if number:
            status = content[place + CODE_BYTES]
            codes.append(TroubleCode(number=number, status=status, text=description.trouble_text(number)))
    return tuple(codes)


def read_snapshots(response: bytes, description: Description) -> tuple[FailureRecord, ...]:
    """Return the snapshots in a response to 19 04; raises MalformedAnswerError if it is cut off."""
    content = response[HEAD_BYTES[SNAPSHOTS] :]
    snapshots = []
    while any(content):
        _check_whole(response, content, 2)
        number, count = content[0], content[1]
        data, content = _data_of(content[2:], count, description)
        is_complete = count > 0 and len(data) == count  # 0: too many to be counted
        snapshots.append(FailureRecord(number=number, data=data, rest=b"" if is_complete else content))
        if not is_complete:
            break
    return tuple(snapshots)


def _data_of(content: bytes, count: int, description: Description) -> tuple[dict[str, Values], bytes]:
    """Return up to ``count`` data by name, fewer if one has unknown length, and the remaining bytes."""
    data: dict[str, Values] = {}
    for _ in range(count):
        _check_whole(content, content, 2)
        number = int.from_bytes(content[:2], "big")
        size = description.size_bytes(number)
        if size is None:
            break
        _check_whole(content, content, 2 + size)
        name = description.data_name(number)
        data[f"{name} ({number:04X})" if name in data else name] = description.values(number, content[2 : 2 + size])
        content = content[2 + size :]
    return data, content


def read_extended(response: bytes, description: Description) -> tuple[FailureRecord, ...]:
    """Return the extended data in a response to 19 06; raises MalformedAnswerError if it is cut off."""
    content = response[HEAD_BYTES[EXTENDED] :]
    records = []
    while any(content):
        record = description.extended.get(content[0])
        size = None if record is None else record.size_bytes
        _check_whole(response, content, 1 + (size or 1))
        number, content = content[0], content[1:]
        if record is None or size is None:
            records.append(FailureRecord(number=number, data={}, rest=content))
            break
        values = read_fields(record.fields, content[:size])
        records.append(FailureRecord(number=number, data={record.name: values}))
        content = content[size:]
    return tuple(records)


def _check_whole(response: bytes, content: bytes, size_bytes: int) -> None:
    if len(content) < size_bytes:
        raise MalformedAnswerError(f"what was kept of a trouble code is cut off: {hex_text(response)}")


Record = dict[str, object]
NOTHING: Final = "not available"


def code_words(code: TroubleCode) -> str:
    """Return a code with its text and state."""
    state = "confirmed" if code.is_confirmed else "pending" if code.is_pending else "not confirmed"
    return f"{code.code} {code.text} ({state})" if code.text else f"{code.code} ({state})"


def trouble_record(code: TroubleCode) -> Record:
    return {
        "code": code.code,
        "failure_type": code.failure_type,
        "number": f"{code.number:06X}",
        "text": code.text,
        "status": code.status,
        "states": list(code.states),
        "snapshots": [_snapshot_record(record) for record in code.snapshots],
        "extended_data": [_snapshot_record(record) for record in code.extended],
    }


def _snapshot_record(snapshot: FailureRecord) -> Record:
    data = {name: dict(values) for name, values in snapshot.data.items()}
    return {"number": snapshot.number, "data": data, "rest": snapshot.rest.hex(" ").upper()}


def trouble_lines(codes: Sequence[TroubleCode]) -> Iterator[str]:
    """Yield a line for each code, followed by its snapshots and extended data."""
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


def _kept_lines(what: str, records: Iterable[FailureRecord]) -> Iterator[str]:
    for record in records:
        parts = [f"{name}: {values_text(values)}" for name, values in record.data.items()]
        if record.rest:
            parts.append(f"not understood: {record.rest.hex(' ').upper()}")
        yield f"  {what} {record.number:02X}: {'; '.join(parts)}"


def values_text(values: Values) -> str:
    """Return values for people: name, number, unit; a single value without its name."""
    texts = []
    for label, value in values.items():
        value_text = NOTHING if value is None else digits(value) if isinstance(value, float) else str(value)
        name, bracket, unit = label.partition(" [")
        unit = f" {unit.removesuffix(']')}" if bracket and value is not None else ""
        texts.append(f"{name if len(values) > 1 else ''} {value_text}{unit}".strip())
    return ", ".join(texts)


def columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines, each column as wide as its longest entry."""
    widths = [max(len(row[place]) for row in (head, *rows)) for place in range(len(head))]
    return ["  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip()
            for row in (head, *rows)]  # fmt: skip
