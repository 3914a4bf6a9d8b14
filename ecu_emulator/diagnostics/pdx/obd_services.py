"""OBD for a tool: services 01 to 0A of SAE J1979, or the data of SAE J1979-2, which UDS reads."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Final

from ecu_emulator.diagnostics.codes import ObdService
from ecu_emulator.diagnostics.codes import Service as Number
from ecu_emulator.diagnostics.descriptions import Access, Field, Kind
from ecu_emulator.diagnostics.obd_descriptions import BLOCK, Obd, Pid, VehicleInfo, supported
from ecu_emulator.diagnostics.pdx.coded_types import described, raw, rest, unsigned
from ecu_emulator.diagnostics.pdx.dictionary import Dictionary
from ecu_emulator.diagnostics.pdx.parameters import Parameter, constant, value
from ecu_emulator.diagnostics.pdx.service import Service, access_to
from ecu_emulator.diagnostics.services.obd import (
    CODE_OF_FRAME,
    COUNTER_TEST,
    FRAME,
    MOST_FROZEN_PIDS,
    MOST_PIDS,
    ONE_ITEM,
    SIGNED_COUNT,
)
from ecu_emulator.diagnostics.services.obd_data import INFO_DATA, PID_DATA
from ecu_emulator.diagnostics.table import DiagnosticTable

_BITMAP_BYTES: Final = 4
_CODE_BYTES: Final = 2
_RESULTS: Final = ("result", "least", "most")


class ObdNames:
    """What the dictionary calls the values of OBD."""

    def __init__(self, table: DiagnosticTable, obd: Obd, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self.bitmap = value(
            "supported", dictionary.simple("bitmap of what is there", raw(_BITMAP_BYTES)), _BITMAP_BYTES
        )
        self.pids = {pid.number: dictionary.fields(f"OBD {pid.name}", _fields(pid)) for pid in obd.pids.values()}
        self.infos = {info.number: self._info(table, info) for info in obd.infos.values()}

    def pid(self, pid: Pid) -> Parameter:
        """Return a parameter that holds one of OBD."""
        return value(pid.name, self.pids[pid.number], sum(entry.size_bytes for entry in pid.fields))

    def bitmaps(self, known: Mapping[int, object]) -> Iterator[int]:
        """Yield the numbers of the bitmaps that there are."""
        return (first for first in range(0, 0x100, BLOCK) if supported(known, first) is not None)

    def _info(self, table: DiagnosticTable, info: VehicleInfo) -> Parameter:
        is_text = bool(info.text) or (info.data is not None and table.data[info.data].fields[0].kind is Kind.TEXT)
        content = Field(name=info.name, kind=Kind.TEXT if is_text else Kind.BYTES, size_bytes=info.size_bytes)
        return value(info.name, self._dictionary.simple(f"OBD {info.name}", described(content)), info.size_bytes)


def _fields(pid: Pid) -> tuple[Field, ...]:
    """Return the fields of a parameter; in OBD all bits set are a value like others."""
    return tuple(replace(entry, source="") for entry in pid.fields)


def emission_data_services(table: DiagnosticTable, obd: Obd, dictionary: Dictionary) -> Iterator[Service]:
    """Yield a service for each datum of SAE J1979-2: parameters F4xx, vehicle information F8xx."""
    names, access = ObdNames(table, obd, dictionary), access_to(table, Number.READ_DATA)
    found: dict[int, tuple[str, Parameter]] = {
        PID_DATA | pid.number: (pid.name, names.pid(pid)) for pid in obd.pids.values()
    }
    found |= {INFO_DATA | info.number: (info.name, names.infos[info.number]) for info in obd.infos.values()}
    for page, known in ((PID_DATA, obd.pids), (INFO_DATA, obd.infos)):
        found |= {page | first: (f"supported {page | first:04X}", names.bitmap) for first in names.bitmaps(known)}
    for number, (name, content) in found.items():
        identifier = constant("identifier", number, 2, "ID")
        yield Service(
            name=f"Read OBD {name}",
            number=Number.READ_DATA,
            semantic="CURRENTDATA",
            request=(identifier,),
            responses=((identifier, content),),
            access=access,
        )


def obd_services(table: DiagnosticTable, obd: Obd, dictionary: Dictionary) -> Iterator[Service]:
    """Yield the services of SAE J1979 on CAN."""
    names, access = ObdNames(table, obd, dictionary), Access(sessions=tuple(table.sessions))
    yield from _parameters(obd, dictionary, names, access)
    yield from _freeze_frame(obd, dictionary, names, access)
    yield from _codes(table, dictionary, access)
    yield _service("Clear trouble codes of OBD", ObdService.CLEAR, "FAULTCLEAR", access, (), ())
    yield from _monitors(obd, dictionary, names, access)
    yield from _information(obd, names, access)


def _service(
    name: str,
    number: int,
    semantic: str,
    access: Access,
    request: tuple[Parameter, ...],
    response: tuple[Parameter, ...],
) -> Service:
    return Service(name=name, number=number, semantic=semantic, request=request, responses=(response,), access=access)


def _supported(
    what: str, service: int, names: ObdNames, known: Mapping[int, object], access: Access, *more: Parameter
) -> Iterator[Service]:
    """Yield the services that read which numbers are there; ``more`` comes behind the number, back and forth."""
    for first in names.bitmaps(known):
        begin = (constant("number", first, semantic="ID"), *more)
        name = f"Read supported {what} {first:02X}"
        yield _service(name, service, "IDENTIFICATION", access, begin, (*begin, names.bitmap))


def _parameters(obd: Obd, dictionary: Dictionary, names: ObdNames, access: Access) -> Iterator[Service]:
    service, kind = ObdService.CURRENT_DATA, "CURRENTDATA"
    for pid in obd.pids.values():
        number = constant("number", pid.number, semantic="ID")
        yield _service(f"Read {pid.name}", service, kind, access, (number,), (number, names.pid(pid)))
    yield from _supported("parameters", service, names, obd.pids, access)
    asked = dictionary.structure("asked parameter", (value("number", _number(dictionary, "parameter"), 1),))
    several = value("parameters", dictionary.repeated("asked parameters", asked, MOST_PIDS, 1))
    read = value("parameters", dictionary.simple("parameters with their numbers", rest(1)))
    yield _service("Read several data", service, kind, access, (several,), (read,))


def _number(dictionary: Dictionary, what: str) -> str:
    return dictionary.simple(f"number of a {what}", unsigned(1, is_hexadecimal=True))


def _freeze_frame(obd: Obd, dictionary: Dictionary, names: ObdNames, access: Access) -> Iterator[Service]:
    service, kind = ObdService.FREEZE_FRAME, "FAULTREAD"
    frame = constant("frame", FRAME)
    frozen = {pid.number: pid for pid in obd.pids.values() if pid.is_frozen}
    for pid in frozen.values():
        begin = constant("number", pid.number, semantic="ID"), frame
        yield _service(f"Read frozen {pid.name}", service, kind, access, begin, (*begin, names.pid(pid)))
    code = value("code", dictionary.simple("code of the freeze frame", unsigned(_CODE_BYTES, is_hexadecimal=True)), 2)
    begin = constant("number", CODE_OF_FRAME, semantic="ID"), frame
    yield _service("Read code of the freeze frame", service, kind, access, begin, (*begin, code))
    yield from _supported("frozen parameters", service, names, {CODE_OF_FRAME: code, **frozen}, access, frame)
    pair = value("number", _number(dictionary, "frozen parameter"), 1), value("frame", _number(dictionary, "frame"), 1)
    asked = dictionary.structure("asked frozen parameter", pair)
    several = value("parameters", dictionary.repeated("asked frozen parameters", asked, MOST_FROZEN_PIDS, 1))
    read = value("parameters", dictionary.simple("frozen parameters with their numbers", rest(1)))
    yield _service("Read several frozen parameters", service, kind, access, (several,), (read,))


def _codes(table: DiagnosticTable, dictionary: Dictionary, access: Access) -> Iterator[Service]:
    troubles = tuple({trouble.code: trouble for trouble in table.troubles.values()}.values())
    plain = unsigned(_CODE_BYTES, is_hexadecimal=True)
    code = dictionary.short_codes("trouble code", troubles) if troubles else dictionary.simple("trouble code", plain)
    item = dictionary.structure("stored trouble code", (value("trouble_code", code, _CODE_BYTES),))
    count = dictionary.simple("number of trouble codes", unsigned(1))
    found = (value("trouble_codes", dictionary.counted("trouble codes", item, count)),)
    for name, service in (
        ("confirmed", ObdService.CONFIRMED_CODES),
        ("pending", ObdService.PENDING_CODES),
        ("permanent", ObdService.PERMANENT_CODES),
    ):
        yield _service(f"Read {name} trouble codes", service, "FAULTREAD", access, (), found)


def _monitors(obd: Obd, dictionary: Dictionary, names: ObdNames, access: Access) -> Iterator[Service]:
    service = ObdService.TEST_RESULTS
    number = dictionary.simple("result of a test", described(Field(name="result", kind=Kind.SIGNED, size_bytes=2)))
    content = constant("test", COUNTER_TEST), constant("unit_and_scaling", SIGNED_COUNT)
    results = tuple(value(name, number, 2) for name in _RESULTS)
    for monitor in obd.monitors.values():
        begin = constant("number", monitor.number, semantic="ID")
        response = (begin, *content, *results)
        yield _service(f"Read test of {monitor.code}", service, "FAULTREAD", access, (begin,), response)
    yield from _supported("tests", service, names, obd.monitors, access)


def _information(obd: Obd, names: ObdNames, access: Access) -> Iterator[Service]:
    service = ObdService.VEHICLE_INFORMATION
    for info in obd.infos.values():
        number = constant("number", info.number, semantic="ID")
        response = (number, constant("items", ONE_ITEM), names.infos[info.number])
        yield _service(f"Read {info.name}", service, "IDENTIFICATION", access, (number,), response)
    yield from _supported("vehicle information", service, names, obd.infos, access)
