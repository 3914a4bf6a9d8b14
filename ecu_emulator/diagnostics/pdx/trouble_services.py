"""Services 14 and 19 for a tool: trouble codes, what is kept with them, and how they are forgotten."""

from collections.abc import Iterator
from typing import Final

from ecu_emulator.diagnostics.codes import ALL_CODES
from ecu_emulator.diagnostics.codes import Service as Number
from ecu_emulator.diagnostics.descriptions import Access, Field, Kind
from ecu_emulator.diagnostics.emissions import ALL_EMISSION_CODES
from ecu_emulator.diagnostics.memory import FIRST_RECORD, LATEST_RECORD
from ecu_emulator.diagnostics.obd_descriptions import Profile
from ecu_emulator.diagnostics.pdx.coded_types import described, unsigned, worded
from ecu_emulator.diagnostics.pdx.data_services import DataNames
from ecu_emulator.diagnostics.pdx.dictionary import Dictionary
from ecu_emulator.diagnostics.pdx.parameters import Parameter, constant, value
from ecu_emulator.diagnostics.pdx.service import Service, access_to, simple
from ecu_emulator.diagnostics.services.trouble import (
    ALL_RECORDS,
    ALL_REGULATED_RECORDS,
    ALL_SEVERITIES,
    CODE_FORMAT,
    CODE_FORMAT_J2012,
    EMISSION_GROUP,
    FIRST_REGULATED,
)
from ecu_emulator.diagnostics.table import DiagnosticTable

_BITS: Final = (
    "test failed",
    "test failed this operation cycle",
    "pending",
    "confirmed",
    "test not completed since last clear",
    "test failed since last clear",
    "test not completed this operation cycle",
    "warning indicator requested",
)
_SNAPSHOTS: Final = {FIRST_RECORD: "first failure", LATEST_RECORD: "latest failure", ALL_RECORDS: "all"}
_SEMANTIC: Final = "FAULTREAD"


class TroubleNames:
    """What the dictionary calls trouble codes and what goes with them."""

    def __init__(self, table: DiagnosticTable, dictionary: Dictionary) -> None:
        troubles = tuple(table.troubles.values())
        plain = unsigned(3, is_hexadecimal=True)
        code = dictionary.codes("trouble code", troubles) if troubles else dictionary.simple("trouble code", plain)
        self.code = value("trouble_code", code, 3)
        flags = dictionary.flags("status of a trouble code", _BITS)
        self.status = value("status", flags, 1)
        self.availability = value("status_availability", flags, 1)
        self.record = value("record", dictionary.simple("number of a record", unsigned(1)), 1)


def clearing_services(table: DiagnosticTable, _dictionary: Dictionary, names: TroubleNames) -> Iterator[Service]:
    """Yield the services that forget trouble codes."""
    access = access_to(table, Number.CLEAR_CODES)
    everything = constant("group", ALL_CODES, 3)
    yield _clearing("Clear all trouble codes", everything, access)
    if table.has_obd(Profile.UDS):
        yield _clearing("Clear trouble codes of OBD", constant("group", ALL_EMISSION_CODES, 3), access)
    if table.troubles:
        yield _clearing("Clear trouble code", names.code, access)


def _clearing(name: str, group: Parameter, access: Access) -> Service:
    return Service(name=name, number=Number.CLEAR_CODES, semantic="FAULTCLEAR", request=(group,), access=access)


def trouble_services(
    table: DiagnosticTable, dictionary: Dictionary, names: TroubleNames, data: DataNames
) -> Iterator[Service]:
    """Yield a service for each report of service 19."""
    access = access_to(table, Number.READ_CODES)
    pair = dictionary.structure("trouble code with status", (names.code, names.status))
    codes = (names.availability, value("trouble_codes", dictionary.repeated("trouble codes", pair)))
    mask = (value("status_mask", dictionary.simple("mask of status", unsigned(1, is_hexadecimal=True)), 1),)
    count = (
        names.availability,
        value("format", dictionary.simple("format of trouble codes", worded({CODE_FORMAT: "SAE J2012-DA"}, 8)), 1),
        value("count", dictionary.simple("count of trouble codes", unsigned(2)), 2),
    )
    number = Number.READ_CODES
    yield simple("Count trouble codes by status", number, 0x01, _SEMANTIC, access, request=mask, response=count)
    yield simple("Read trouble codes by status", number, 0x02, _SEMANTIC, access, request=mask, response=codes)
    kept = dictionary.structure("trouble code with record", (names.code, names.record))
    found = (value("snapshots", dictionary.repeated("names of snapshots", kept)),)
    yield simple("Read names of snapshots", number, 0x03, _SEMANTIC, access, response=found)
    if table.troubles:
        yield _snapshots(table, dictionary, names, data)
        yield _extended(table, dictionary, names)
        choices = worded({record.number: record.name for record in table.extended.values()}, 8)
        record = value("record", dictionary.simple("record of extended data", choices), 1)
        with_record = (names.availability, record, *codes[1:])
        name = "Read trouble codes with extended data"
        yield simple(name, number, 0x1A, _SEMANTIC, access, request=(record,), response=with_record)
    yield simple("Read supported trouble codes", number, 0x0A, _SEMANTIC, access, response=codes)
    counter = Field(name="counter", kind=Kind.SIGNED, size_bytes=1)
    counted = (names.code, value("counter", dictionary.simple("fault detection counter", described(counter)), 1))
    counters = dictionary.repeated(
        "fault detection counters", dictionary.structure("trouble code with counter", counted)
    )
    found = (value("counters", counters),)
    yield simple("Read fault detection counters", number, 0x14, _SEMANTIC, access, response=found)
    if table.has_obd(Profile.UDS):
        yield from _emission_reports(table, dictionary, names, access, codes)


def _emission_reports(
    table: DiagnosticTable, dictionary: Dictionary, names: TroubleNames, access: Access, codes: tuple[Parameter, ...]
) -> Iterator[Service]:
    """Yield the reports of SAE J1979-2: codes by masks, and those that no client can clear."""
    number, group = Number.READ_CODES, constant("group", EMISSION_GROUP)
    byte = dictionary.simple("mask of status and severity", unsigned(1, is_hexadecimal=True))
    masks = value("status_mask", byte, 1), value("severity_mask", byte, 1)
    formats = dictionary.simple("format of trouble codes of OBD", worded({CODE_FORMAT_J2012: "SAE J2012-DA"}, 8))
    severity = value("severity", dictionary.simple("severity", unsigned(1, is_hexadecimal=True)), 1)
    entry = dictionary.structure("trouble code with severity", (severity, names.code, names.status))
    found = value("trouble_codes", dictionary.repeated("trouble codes with severity", entry))
    severities = constant("severity_availability", ALL_SEVERITIES)
    yield simple(
        "Read trouble codes of OBD",
        number,
        0x42,
        _SEMANTIC,
        access,
        request=(group, *masks),
        response=(group, names.availability, severities, value("format", formats, 1), found),
    )
    permanent = (group, names.availability, value("format", formats, 1), *codes[1:])
    readiness = constant("readiness_group", 0 if table.obd is None else table.obd.readiness_group)
    ready = (*permanent[:3], readiness, *codes[1:])
    name = "Read trouble codes of a readiness group"
    yield simple(name, number, 0x56, _SEMANTIC, access, request=(group, readiness), response=ready)
    yield simple("Read permanent trouble codes", number, 0x55, _SEMANTIC, access, request=(group,), response=permanent)


def _snapshots(table: DiagnosticTable, dictionary: Dictionary, names: TroubleNames, data: DataNames) -> Service:
    wanted = {number for trouble in table.troubles.values() for number in table.snapshot_of(trouble)}
    cases = {number: structure for number, structure in data.structures.items() if number in wanted}
    switch = dictionary.switched("snapshot by identifier", data.number, 2, cases)
    datum = dictionary.structure("snapshot datum", (value("datum", switch),))
    size = dictionary.simple("number of snapshot data", unsigned(1))
    content = value("data", dictionary.counted("snapshot data", datum, size))
    record = dictionary.structure("snapshot", (names.record, content))
    asked = value("record", dictionary.simple("snapshot to read", worded(_SNAPSHOTS, 8)), 1)
    found = value("snapshots", dictionary.repeated("snapshots", record))
    return simple(
        "Read snapshots",
        Number.READ_CODES,
        0x04,
        _SEMANTIC,
        access_to(table, Number.READ_CODES),
        request=(names.code, asked),
        response=(names.code, names.status, found),
    )


def _extended(table: DiagnosticTable, dictionary: Dictionary, names: TroubleNames) -> Service:
    choices = {record.number: record.name for record in table.extended.values()} | {ALL_RECORDS: "all"}
    if max(table.extended, default=0) >= FIRST_REGULATED:
        choices[ALL_REGULATED_RECORDS] = "all regulated"
    cases = {entry.number: dictionary.fields(f"record {entry.name}", entry.fields) for entry in table.extended.values()}
    number = dictionary.simple("number of extended data", unsigned(1))
    record = dictionary.structure(
        "extended record", (value("record", dictionary.switched("extended data by number", number, 1, cases)),)
    )
    asked = value("record", dictionary.simple("extended data to read", worded(choices, 8)), 1)
    return simple(
        "Read extended data",
        Number.READ_CODES,
        0x06,
        _SEMANTIC,
        access_to(table, Number.READ_CODES),
        request=(names.code, asked),
        response=(names.code, names.status, value("records", dictionary.repeated("extended data", record))),
    )
