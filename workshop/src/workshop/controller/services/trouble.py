"""Trouble codes: services 14 (clear) and 19 (read)."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Final

from workshop.controller.descriptions import IN_USE, OF_MEMORY, ExtendedRecord, ObdProfile, Trouble, encode
from workshop.controller.iso14229 import ALL_BITS, ALL_CODES, Nrc
from workshop.controller.memory import (
    ALL_EMISSION_CODES,
    FAILED_COUNTER,
    FIRST_RECORD,
    LATEST_RECORD,
    Capture,
    TroubleRecord,
    after_clear,
    clear,
    emission_codes,
)
from workshop.controller.services.data import data_of, odometer_m
from workshop.controller.state import Call, Instant, Result, ServerState, unmet_by_service
from workshop.controller.table import DiagnosticTable

CODE_FORMAT: Final = 0x00  # SAE J2012-DA: a code of two bytes and a failure type
ALL_RECORDS: Final = 0xFF
ALL_REGULATED_RECORDS: Final = 0xFE  # those from 0x90 on
FIRST_REGULATED: Final = 0x90
EMISSION_GROUP: Final = 0x33  # functional group of SAE J1979-2
CODE_FORMAT_J2012: Final = 0x04
ALL_SEVERITIES: Final = 0xE0
_CODE_BYTES: Final = 3


def capture(table: DiagnosticTable, trouble: Trouble, state: ServerState, moment: Instant) -> Capture:
    """Return what is kept of the vehicle when this code fails now."""
    values = {**moment.values, "active_session": state.session}
    records = [table.extended[number] for number in table.extended_of(trouble)]
    return Capture(
        snapshot=tuple((number, data_of(table.data[number], state, moment)) for number in table.snapshot_of(trouble)),
        extended=tuple((record.number, encode(record.fields, values)) for record in records if not record.has_counters),
    )


def clear_codes(call: Call) -> Result:
    if len(call.payload) != 1 + _CODE_BYTES:
        return Nrc.INCORRECT_LENGTH
    group = int.from_bytes(call.payload[1:], "big")
    has_emission_group = call.table.has_obd(ObdProfile.UDS) and group == ALL_EMISSION_CODES
    if group != ALL_CODES and group not in call.table.troubles and not has_emission_group:
        return Nrc.REQUEST_OUT_OF_RANGE
    if refusal := unmet_by_service(call):
        return refusal
    return call.positive(state=cleared(call, group))


def cleared(call: Call, group: int) -> ServerState:
    """Return the state without what was known of one code, of all, or of those of OBD."""
    memory = call.state.memory
    emission_codes_alone = [number for number, trouble in call.table.troubles.items() if trouble.lights_lamp]
    for number in emission_codes_alone if group == ALL_EMISSION_CODES else [group]:
        memory = clear(memory, number)
    emissions = after_clear(call.state.emissions, memory, group, odometer_m(call.moment))
    return replace(call.state, memory=memory, emissions=emissions)


def read_codes(call: Call) -> Result:
    """Read trouble codes in one of the ways of service 19."""
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
    """Return the codes that have one of the bits that the client named."""
    return [number for number, record in call.state.memory.records.items() if record.status & call.payload[2]]


def _listed(call: Call, numbers: Iterable[int]) -> bytes:
    return b"".join(_code(number) + bytes([call.state.memory.records[number].status]) for number in numbers)


def _snapshot_names(call: Call) -> bytes:
    records = call.state.memory.records.items()
    return b"".join(_code(number) + bytes([name]) for number, record in records for name, _ in _snapshots(record))


def _extended_by_code(call: Call) -> bytes | Nrc:
    names = {ALL_RECORDS, *call.table.extended}
    if max(call.table.extended, default=0) >= FIRST_REGULATED:
        names.add(ALL_REGULATED_RECORDS)
    return _kept_by_code(call, names, _extended_records)


def _kept_by_code(
    call: Call, names: Collection[int], kept: Callable[[Call, Trouble, TroubleRecord, int], bytes]
) -> bytes | Nrc:
    """Return a code, its status and what is kept of it; no more than the status if nothing is."""
    number, name = int.from_bytes(call.payload[2:5], "big"), call.payload[5]
    trouble = call.table.troubles.get(number)
    if trouble is None or name not in names:
        return Nrc.REQUEST_OUT_OF_RANGE
    record = call.state.memory.records[number]
    return _code(number) + bytes([record.status]) + kept(call, trouble, record, name)


def _snapshots(record: TroubleRecord) -> list[tuple[int, Capture]]:
    both = ((FIRST_RECORD, record.first), (LATEST_RECORD, record.latest))
    return [(name, kept) for name, kept in both if kept is not None]


def _snapshot_records(_call: Call, _trouble: Trouble, record: TroubleRecord, wanted: int) -> bytes:
    return b"".join(
        bytes([name, len(kept.snapshot)]) + b"".join(number.to_bytes(2, "big") + data for number, data in kept.snapshot)
        for name, kept in _snapshots(record)
        if wanted in {name, ALL_RECORDS}
    )


def _extended_records(call: Call, trouble: Trouble, record: TroubleRecord, wanted: int) -> bytes:
    captured = {} if record.latest is None else dict(record.latest.extended)
    least = {ALL_RECORDS: 0, ALL_REGULATED_RECORDS: FIRST_REGULATED}
    return b"".join(
        bytes([number])
        + (_counters(call, described, trouble, record) if described.has_counters else captured.get(number, b""))
        for number in call.table.extended_of(trouble)
        if (described := call.table.extended[number]) is IN_USE or record.has_data
        if number == wanted or (wanted in least and number >= least[wanted])
    )


def _counters(call: Call, described: ExtendedRecord, trouble: Trouble, record: TroubleRecord) -> bytes:
    emissions = call.state.emissions
    return encode(
        described.fields,
        {
            f"{OF_MEMORY}occurrences": record.occurrences,
            f"{OF_MEMORY}failed_cycles": record.failed_cycles,
            f"{OF_MEMORY}passed_cycles": record.passed_cycles,
            f"{OF_MEMORY}aged_cycles": record.aged_cycles,
            f"{OF_MEMORY}detection_counter": record.detection_counter,
            f"{OF_MEMORY}ran_cycles": emissions.ran_cycles.get(trouble.number, 0),
            f"{OF_MEMORY}driven_cycles": emissions.driven_cycles,
        },
    )


def _detection_counters(call: Call) -> bytes:
    """Return the codes on their way to a failure that are not there yet."""
    return b"".join(
        _code(number) + bytes([record.detection_counter])
        for number, record in call.state.memory.records.items()
        if 0 < record.detection_counter < FAILED_COUNTER
    )


def _emission_codes_by_mask(call: Call) -> bytes | Nrc:
    """Return severity, code and status of the codes of OBD that have a bit of each mask."""
    group, status_mask, severity_mask = call.payload[2:5]
    if group != EMISSION_GROUP:
        return Nrc.REQUEST_OUT_OF_RANGE
    troubles, memory = call.table.troubles, call.state.memory
    found = emission_codes(troubles, memory, status_mask)
    return bytes([EMISSION_GROUP, ALL_BITS, ALL_SEVERITIES, CODE_FORMAT_J2012]) + b"".join(
        bytes([troubles[number].severity]) + _code(number) + bytes([memory.records[number].status])
        for number in found
        if troubles[number].severity & severity_mask
    )


def _permanent_codes(call: Call) -> bytes | Nrc:
    if call.payload[2] != EMISSION_GROUP:
        return Nrc.REQUEST_OUT_OF_RANGE
    permanent = sorted(call.state.emissions.permanent)
    return bytes([EMISSION_GROUP, ALL_BITS, CODE_FORMAT_J2012]) + _listed(call, permanent)


def _codes_by_record(call: Call) -> bytes | Nrc:
    """Return the codes that can have an extended record."""
    name, table = call.payload[2], call.table
    numbers = [number for number, trouble in table.troubles.items() if name in table.extended_of(trouble)]
    return bytes([ALL_BITS, name]) + _listed(call, numbers) if numbers else Nrc.REQUEST_OUT_OF_RANGE


def _codes_by_readiness(call: Call) -> bytes | Nrc:
    """Return the codes of OBD of a readiness group; there is one, to which all belong."""
    obd = call.table.obd
    if obd is None or call.payload[2:] != bytes([EMISSION_GROUP, obd.readiness_group]):
        return Nrc.REQUEST_OUT_OF_RANGE
    numbers = [number for number, trouble in call.table.troubles.items() if trouble.lights_lamp]
    head = bytes([EMISSION_GROUP, ALL_BITS, CODE_FORMAT_J2012, obd.readiness_group])
    return head + _listed(call, numbers)


def _code(number: int) -> bytes:
    return number.to_bytes(_CODE_BYTES, "big")


_Report = Callable[[Call], bytes | Nrc]
_REPORTS: Final[Mapping[int, tuple[int, _Report]]] = {  # with the length of the request
    0x01: (3, lambda call: bytes([ALL_BITS, CODE_FORMAT]) + len(_masked(call)).to_bytes(2, "big")),
    0x02: (3, lambda call: bytes([ALL_BITS]) + _listed(call, _masked(call))),
    0x03: (2, _snapshot_names),
    0x04: (6, lambda call: _kept_by_code(call, (FIRST_RECORD, LATEST_RECORD, ALL_RECORDS), _snapshot_records)),
    0x06: (6, _extended_by_code),
    0x0A: (2, lambda call: bytes([ALL_BITS]) + _listed(call, call.state.memory.records)),  # all that are supported
    0x14: (2, _detection_counters),
    0x1A: (3, _codes_by_record),
    0x42: (5, _emission_codes_by_mask),
    0x55: (3, _permanent_codes),
    0x56: (4, _codes_by_readiness),
}
EMISSION_REPORTS: Final = frozenset({0x42, 0x55, 0x56})  # of SAE J1979-2
REPORTS: Final = frozenset(_REPORTS) - EMISSION_REPORTS
