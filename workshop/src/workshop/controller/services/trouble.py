"""Trouble codes: services 14 (clear) and 19 (read)."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Final

from workshop.controller.descriptions import OF_MEMORY, ExtendedRecord, encode
from workshop.controller.iso14229 import ALL_BITS, ALL_CODES, Nrc
from workshop.controller.memory import (
    FAILED_COUNTER,
    FIRST_RECORD,
    LATEST_RECORD,
    Capture,
    TroubleRecord,
    after_clear,
    clear,
)
from workshop.controller.services.data import data_of, odometer_m
from workshop.controller.state import Call, Instant, Result, ServerState, unmet_by_service
from workshop.controller.table import DiagnosticTable

CODE_FORMAT: Final = 0x00  # SAE J2012-DA: a code of two bytes and a failure type
ALL_RECORDS: Final = 0xFF
_CODE_BYTES: Final = 3


def capture(table: DiagnosticTable, state: ServerState, moment: Instant) -> Capture:
    """Return the snapshot and extended data of a failure now."""
    values = {**moment.values, "active_session": state.session}
    return Capture(
        snapshot=tuple((number, data_of(table.data[number], state, moment)) for number in table.snapshot),
        extended=tuple(
            (record.number, encode(record.fields, values))
            for record in table.extended.values()
            if not record.has_counters
        ),
    )


def clear_codes(call: Call) -> Result:
    if len(call.payload) != 1 + _CODE_BYTES:
        return Nrc.INCORRECT_LENGTH
    group = int.from_bytes(call.payload[1:], "big")
    if group != ALL_CODES and group not in call.table.troubles:
        return Nrc.REQUEST_OUT_OF_RANGE
    if refusal := unmet_by_service(call):
        return refusal
    return call.positive(state=cleared(call, group))


def cleared(call: Call, group: int) -> ServerState:
    """Return the state with one code, or all codes, cleared."""
    memory = clear(call.state.memory, group)
    emissions = after_clear(call.state.emissions, memory, group, odometer_m(call.moment))
    return replace(call.state, memory=memory, emissions=emissions)


def read_codes(call: Call) -> Result:
    """Read trouble codes: a report of service 19."""
    size_bytes, report = _REPORTS[call.sub_function]
    if len(call.payload) != size_bytes:
        return Nrc.INCORRECT_LENGTH
    result = report(call)
    if isinstance(result, Nrc):
        return result
    if 2 + len(result) > call.table.limits.most_response_bytes:
        return Nrc.RESPONSE_TOO_LONG
    return call.echoed(result)


def _masked(call: Call) -> list[int]:
    """Return the codes with a status bit of the requested mask."""
    return [number for number, record in call.state.memory.records.items() if record.status & call.payload[2]]


def _listed(call: Call, numbers: Iterable[int]) -> bytes:
    return b"".join(_code(number) + bytes([call.state.memory.records[number].status]) for number in numbers)


def _snapshot_names(call: Call) -> bytes:
    records = call.state.memory.records.items()
    return b"".join(_code(number) + bytes([name]) for number, record in records for name, _ in _snapshots(record))


def _stored_records(
    call: Call, names: Collection[int], read: Callable[[Call, TroubleRecord, int], bytes]
) -> bytes | Nrc:
    """Return a code, its status and its stored records, if there are any."""
    number, name = int.from_bytes(call.payload[2:5], "big"), call.payload[5]
    record = call.state.memory.records.get(number)
    if record is None or name not in names:
        return Nrc.REQUEST_OUT_OF_RANGE
    return _code(number) + bytes([record.status]) + read(call, record, name)


def _snapshots(record: TroubleRecord) -> list[tuple[int, Capture]]:
    both = ((FIRST_RECORD, record.first), (LATEST_RECORD, record.latest))
    return [(name, failure) for name, failure in both if failure is not None]


def _snapshot_records(_call: Call, record: TroubleRecord, wanted: int) -> bytes:
    return b"".join(
        bytes([name, len(failure.snapshot)])
        + b"".join(number.to_bytes(2, "big") + data for number, data in failure.snapshot)
        for name, failure in _snapshots(record)
        if wanted in {name, ALL_RECORDS}
    )


def _extended_records(call: Call, record: TroubleRecord, wanted: int) -> bytes:
    if record.latest is None:
        return b""
    captured = dict(record.latest.extended)
    return b"".join(
        bytes([number]) + (_counters(described, record) if described.has_counters else captured.get(number, b""))
        for number, described in call.table.extended.items()
        if wanted in {number, ALL_RECORDS}
    )


def _counters(described: ExtendedRecord, record: TroubleRecord) -> bytes:
    return encode(
        described.fields,
        {
            f"{OF_MEMORY}occurrences": record.occurrences,
            f"{OF_MEMORY}failed_cycles": record.failed_cycles,
            f"{OF_MEMORY}passed_cycles": record.passed_cycles,
            f"{OF_MEMORY}aged_cycles": record.aged_cycles,
            f"{OF_MEMORY}detection_counter": record.detection_counter,
        },
    )


def _detection_counters(call: Call) -> bytes:
    """Return the codes with a positive counter that have not failed yet."""
    return b"".join(
        _code(number) + bytes([record.detection_counter])
        for number, record in call.state.memory.records.items()
        if 0 < record.detection_counter < FAILED_COUNTER
    )


def _code(number: int) -> bytes:
    return number.to_bytes(_CODE_BYTES, "big")


_Report = Callable[[Call], bytes | Nrc]
_REPORTS: Final[Mapping[int, tuple[int, _Report]]] = {  # with the length of the request
    0x01: (3, lambda call: bytes([ALL_BITS, CODE_FORMAT]) + len(_masked(call)).to_bytes(2, "big")),
    0x02: (3, lambda call: bytes([ALL_BITS]) + _listed(call, _masked(call))),
    0x03: (2, _snapshot_names),
    0x04: (6, lambda call: _stored_records(call, (FIRST_RECORD, LATEST_RECORD, ALL_RECORDS), _snapshot_records)),
    0x06: (6, lambda call: _stored_records(call, {ALL_RECORDS, *call.table.extended}, _extended_records)),
    0x0A: (2, lambda call: bytes([ALL_BITS]) + _listed(call, call.state.memory.records)),  # all supported codes
    0x14: (2, _detection_counters),
}
REPORTS: Final = frozenset(_REPORTS)
