"""Services as a tool offers them, made of a controller's table: for people a task, on the wire one kind of request."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from odxtools.odxlink import OdxLinkRef

from ecu_emulator.diagnostics.descriptions import (
    BLOCK,
    Access,
    Coding,
    Datum,
    Field,
    Obd,
    Pid,
    Profile,
    Routine,
    VehicleInfo,
    supported,
)
from ecu_emulator.diagnostics.iso14229 import ALL_CODES, ObdService
from ecu_emulator.diagnostics.iso14229 import Service as Number
from ecu_emulator.diagnostics.memory import ALL_EMISSION_CODES, FIRST_RECORD, LATEST_RECORD
from ecu_emulator.diagnostics.pdx.elements import (
    Dictionary,
    Part,
    Parts,
    constant,
    described,
    echo,
    raw,
    rest,
    scaled,
    unsigned,
    value,
    worded,
)
from ecu_emulator.diagnostics.services import data, obd, routines, sessions, trouble
from ecu_emulator.diagnostics.table import PERIODIC_PAGE, DiagnosticTable

_RESETS: Final = {
    sessions.HARD_RESET: "hard reset",
    sessions.KEY_OFF_ON_RESET: "ignition off and on",
    sessions.SOFT_RESET: "soft reset",
}
_TRAFFIC: Final = {
    0: "enable receiving and sending",
    1: "enable receiving, disable sending",
    2: "disable receiving, enable sending",
    3: "disable receiving and sending",
}
_MESSAGES: Final = {1: "normal messages", 2: "network management", 3: "normal messages and network management"}
_SETTINGS: Final = {sessions.CODES_ON: "trouble codes on", sessions.CODES_OFF: "trouble codes off"}
_RATES: Final = {data.SLOW: "Slow", data.MEDIUM: "Medium", data.FAST: "Fast", data.STOP: "Stop"}
_CONTROLS: Final = {data.RETURN_CONTROL: "Return", data.FREEZE: "Freeze", data.ADJUST: "Adjust"}
_ROUTINE_ACTIONS: Final = {routines.START: "Start", routines.STOP: "Stop", routines.RESULTS: "Results of"}
_STATUS_BITS: Final = (
    "test failed",
    "test failed this operation cycle",
    "pending",
    "confirmed",
    "test not completed since last clear",
    "test failed since last clear",
    "test not completed this operation cycle",
    "warning indicator requested",
)
_SNAPSHOTS: Final = {FIRST_RECORD: "first failure", LATEST_RECORD: "latest failure", trouble.ALL_RECORDS: "all"}
_CODE_BYTES: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """One service: its request, its responses, and when it may be asked."""

    name: str
    number: int  # of ISO 14229-1 or SAE J1979
    semantic: str
    request: Parts  # after the service's number
    responses: tuple[Parts, ...]  # likewise; one of them comes
    access: Access
    has_sub_function: bool = False
    enters: int | None = None  # a session
    unlocks: int | None = None  # a security level
    resets: bool = False


class _Services:
    """What services of UDS and OBD have in common."""

    def __init__(self, table: DiagnosticTable, dictionary: Dictionary) -> None:
        self.table, self.dictionary = table, dictionary

    def service(
        self,
        name: str,
        number: int,
        semantic: str,
        request: Parts = (),
        *responses: Parts,
        sub: int | None = None,
        access: Access | None = None,
        **effects: Any,  # noqa: ANN401 - as a service has them
    ) -> Service:
        """Return a service; without responses it has an empty one, and each repeats a sub-function."""
        head: Parts = () if sub is None else (constant("sub_function", sub, semantic="SUBFUNCTION"),)
        return Service(
            name=name,
            number=number,
            semantic=semantic,
            request=(*head, *request),
            responses=tuple((*head, *response) for response in responses or ((),)),
            access=self._access(number, access),
            has_sub_function=sub is not None,
            **effects,
        )

    def _access(self, number: int, own: Access | None) -> Access:
        """Return who may use a service, or do with it what needs an access of its own."""
        service = self.table.services.get(number)
        if service is None:  # of OBD
            return Access(sessions=tuple(self.table.sessions))
        if own is None:
            return Access(sessions=service.sessions, levels=service.levels, conditions=service.conditions)
        levels = service.levels or own.levels
        if service.levels and own.levels:
            levels = tuple(level for level in service.levels if level in own.levels)
        return Access(
            sessions=tuple(session for session in service.sessions if session in own.sessions),
            levels=levels,
            conditions=(*service.conditions, *own.conditions),
        )

    def hexadecimal(self, name: str, size_bytes: int = 1) -> OdxLinkRef:
        """Describe a plain number that tools show in base 16."""
        return self.dictionary.simple(name, unsigned(size_bytes, is_hexadecimal=True))


class UdsServices(_Services):
    """The services of ISO 14229-1 that a table has."""

    def __init__(self, table: DiagnosticTable, dictionary: Dictionary) -> None:
        super().__init__(table, dictionary)
        simple = dictionary.simple
        self._structures = {datum.number: dictionary.fields(datum.name, datum.fields) for datum in table.data.values()}
        self._number, self._low = self.hexadecimal("number of a datum", 2), self.hexadecimal("lower byte of a number")
        labels = {datum.number: f"{datum.number:04X} {datum.name}" for datum in table.data.values()}
        self._choice = simple("data", worded(labels, 16)) if labels else self._number
        troubles = tuple(table.troubles.values())
        code = dictionary.codes("trouble code", troubles, 3) if troubles else self.hexadecimal("trouble code", 3)
        self._code = value("trouble_code", code, 3)
        flags = dictionary.flags("status of a trouble code", _STATUS_BITS)
        self._status, self._availability = value("status", flags, 1), value("status_availability", flags, 1)
        self._record = value("record", simple("number of a record", unsigned(1)), 1)

    def __iter__(self) -> Iterator[Service]:
        makers: dict[int, Callable[[], Iterator[Service]]] = {
            Number.SESSION_CONTROL: self._sessions,
            Number.ECU_RESET: self._resets,
            Number.CLEAR_CODES: self._clearing,
            Number.READ_CODES: self._trouble_codes,
            Number.READ_DATA: self._reading,
            Number.SECURITY_ACCESS: self._security,
            Number.COMMUNICATION_CONTROL: self._communication,
            Number.READ_PERIODICALLY: self._periodic,
            Number.DEFINE_DATA: self._defining,
            Number.WRITE_DATA: self._writing,
            Number.CONTROL_DATA: self._controlling,
            Number.ROUTINE_CONTROL: self._routines,
            Number.TESTER_PRESENT: self._presence,
            Number.CONTROL_CODE_SETTING: self._settings,
        }
        for number, make in makers.items():
            if number in self.table.services:
                yield from make()
        if self.table.obd is not None and self.table.has_obd(Profile.UDS) and Number.READ_DATA in self.table.services:
            yield from ObdServices(self.table, self.table.obd, self.dictionary).by_identifier()

    # --- sessions and what belongs to them ----------------------------------------------------------------------------

    def _sessions(self) -> Iterator[Service]:
        simple = self.dictionary.simple
        times = (
            value("P2", simple("P2", scaled(2, 1.0), unit="ms"), 2),
            value("P2_star", simple("P2_star", scaled(2, 10.0), unit="ms"), 2),
        )
        for session in self.table.sessions.values():
            yield self.service(
                f"Start session {session.name}",
                Number.SESSION_CONTROL,
                "SESSION",
                (),
                times,
                sub=session.number,
                access=Access(sessions=session.from_sessions),
                enters=session.number,
            )

    def _resets(self) -> Iterator[Service]:
        for sub, name in _RESETS.items():
            yield self.service(f"Reset {name}", Number.ECU_RESET, "RESET", sub=sub, resets=True)

    def _security(self) -> Iterator[Service]:
        number = Number.SECURITY_ACCESS
        for level in self.table.levels.values():
            access, size, own = Access(sessions=level.sessions), level.seed_bytes, level.number
            content = self.dictionary.simple(f"seed and key {level.name}", raw(size))
            seed, key = (value("seed", content, size),), (value("key", content, size),)
            yield self.service(f"Request seed {level.name}", number, "SECURITY", (), seed, sub=own, access=access)
            name = f"Send key {level.name}"
            yield self.service(name, number, "SECURITY", key, sub=own + 1, access=access, unlocks=own)

    def _communication(self) -> Iterator[Service]:
        kind = value("messages", self.dictionary.simple("communication type", worded(_MESSAGES)), 1)
        for sub, name in _TRAFFIC.items():
            number = Number.COMMUNICATION_CONTROL
            yield self.service(f"Communication {name}", number, "COMMUNICATION", (kind,), sub=sub)

    def _presence(self) -> Iterator[Service]:
        yield self.service("Tester present", Number.TESTER_PRESENT, "TESTERPRESENT", sub=0)

    def _settings(self) -> Iterator[Service]:
        for sub, name in _SETTINGS.items():
            yield self.service(f"Updating of {name}", Number.CONTROL_CODE_SETTING, "CONTROL", sub=sub)

    # --- data ---------------------------------------------------------------------------------------------------------

    def _content(self, datum: Datum) -> Part:
        return value(datum.name, self._structures[datum.number], datum.size_bytes)

    def _pages(self) -> dict[int, str]:
        """Return upper bytes of data that clients may define."""
        return {data.DEFINABLE_PAGE: "data"} | ({} if self.table.periodic is None else {PERIODIC_PAGE: "periodic data"})

    def _reading(self) -> Iterator[Service]:
        number, dictionary, most = Number.READ_DATA, self.dictionary, self.table.limits.most_data
        for datum in self.table.data.values():
            begin = constant("identifier", datum.number, 2, "ID")
            semantic = "CURRENTDATA" if datum.initial is None else "IDENTIFICATION"
            response = (begin, self._content(datum))
            yield self.service(f"Read {datum.name}", number, semantic, (begin,), response, access=datum.read)
        left = dictionary.simple("bytes of a defined datum", rest(1))
        asked = dictionary.structure("asked datum", (value("identifier", self._choice, 2),))
        other = dictionary.structure("other data", (value("bytes", left),))
        switch = dictionary.switched("read data by identifier", self._number, 2, self._structures, other)
        found = dictionary.structure("read datum", (value("datum", switch),))
        several = (value("data", dictionary.repeated("asked data", asked, most, 1)),)
        answered = (value("data", dictionary.repeated("read data", found, most, 1)),)
        yield self.service("Read several data", number, "CURRENTDATA", several, answered)
        for page, name in self._pages().items():
            defined = constant("page", page, semantic="ID")
            request = (defined, value("number", self._low, 1))
            answer = (defined, echo("number", 2, 1), value("bytes", left))
            yield self.service(f"Read defined {name}", number, "CURRENTDATA", request, answer)

    def _periodic(self) -> Iterator[Service]:
        number = Number.READ_PERIODICALLY
        datum = self.dictionary.structure("periodic datum", (value("number", self._low, 1),))
        asked = value("data", self.dictionary.repeated("periodic data", datum, least=1))
        for mode, verb in _RATES.items():
            yield self.service(f"{verb} periodic data", number, "PERIODIC", (constant("mode", mode), asked))
        yield self.service("Stop all periodic data", number, "PERIODIC", (constant("mode", data.STOP),))

    def _defining(self) -> Iterator[Service]:
        number, kind, dictionary = Number.DEFINE_DATA, "DYN-DEF-MESSAGE", self.dictionary
        byte = dictionary.simple("number of bytes", unsigned(1))
        source = value("source", self._choice, 2)
        piece = dictionary.structure(
            "piece of a datum", (source, value("first_byte", byte, 1), value("bytes", byte, 1))
        )
        pieces = value("pieces", dictionary.repeated("pieces of data", piece, self.table.limits.most_pieces, 1))
        for page, name in self._pages().items():
            upper = constant("page", page, semantic="ID")
            asked, response = (upper, value("number", self._low, 1)), (upper, echo("number", 3, 1))
            define, clear = data.DEFINE_BY_IDENTIFIER, data.CLEAR_DEFINITION
            yield self.service(f"Define {name}", number, kind, (*asked, pieces), response, sub=define)
            yield self.service(f"Forget defined {name}", number, kind, asked, response, sub=clear)
        yield self.service("Forget all defined data", number, kind, sub=data.CLEAR_DEFINITION)

    def _writing(self) -> Iterator[Service]:
        for datum in self.table.data.values():
            if datum.write is not None:
                begin = constant("identifier", datum.number, 2, "ID")
                name, request = f"Write {datum.name}", (begin, self._content(datum))
                yield self.service(name, Number.WRITE_DATA, "STOREDDATA", request, (begin,), access=datum.write)

    def _controlling(self) -> Iterator[Service]:
        for datum in self.table.data.values():
            for action, verb in _CONTROLS.items() if datum.control is not None else ():
                begin = constant("identifier", datum.number, 2, "ID"), constant("action", action)
                whole = (*begin, self._content(datum))
                yield self.service(
                    f"{verb} {datum.name}",
                    Number.CONTROL_DATA,
                    "CONTROL",
                    whole if action == data.ADJUST else begin,
                    whole,
                    access=datum.control,
                )

    def _routines(self) -> Iterator[Service]:
        for routine in self.table.routines.values():
            options = self.dictionary.field_parts(f"option of {routine.name}", routine.options)
            results = self.dictionary.field_parts(f"result of {routine.name}", routine.results)
            number = constant("identifier", routine.number, 2, "ID")
            for sub, verb in _ROUTINE_ACTIONS.items():
                if sub == routines.STOP and not routine.can_be_stopped:
                    continue
                responses = (
                    (number, constant("status", status), *(results if status == routines.COMPLETED else ()))
                    for status in _routine_states(routine, sub)
                )
                yield self.service(
                    f"{verb} {routine.name}",
                    Number.ROUTINE_CONTROL,
                    "ROUTINE",
                    (number, *(options if sub == routines.START else ())),
                    *responses,
                    sub=sub,
                    access=routine.access,
                )

    # --- trouble codes ------------------------------------------------------------------------------------------------

    def _clearing(self) -> Iterator[Service]:
        groups = {"Clear all trouble codes": constant("group", ALL_CODES, 3)}
        if self.table.has_obd(Profile.UDS):
            groups["Clear trouble codes of OBD"] = constant("group", ALL_EMISSION_CODES, 3)
        if self.table.troubles:
            groups["Clear trouble code"] = self._code
        for name, group in groups.items():
            yield self.service(name, Number.CLEAR_CODES, "FAULTCLEAR", (group,))

    def _report(self, name: str, sub: int, request: Parts, *response: Part) -> Service:
        return self.service(name, Number.READ_CODES, "FAULTREAD", request, response, sub=sub)

    def _trouble_codes(self) -> Iterator[Service]:
        dictionary, simple = self.dictionary, self.dictionary.simple
        pair = dictionary.structure("trouble code with status", (self._code, self._status))
        codes = value("trouble_codes", dictionary.repeated("trouble codes", pair))
        mask = (value("status_mask", self.hexadecimal("mask of status"), 1),)
        form = simple("format of trouble codes", worded({trouble.CODE_FORMAT: "SAE J2012-DA"}))
        count = value("format", form, 1), value("count", simple("count of trouble codes", unsigned(2)), 2)
        yield self._report("Count trouble codes by status", 0x01, mask, self._availability, *count)
        yield self._report("Read trouble codes by status", 0x02, mask, self._availability, codes)
        kept = dictionary.structure("trouble code with record", (self._code, self._record))
        names = value("snapshots", dictionary.repeated("names of snapshots", kept))
        yield self._report("Read names of snapshots", 0x03, (), names)
        if self.table.troubles:
            yield self._snapshots()
            yield self._extended()
            choices = worded({record.number: record.name for record in self.table.extended.values()})
            record = value("record", simple("record of extended data", choices), 1)
            name = "Read trouble codes with extended data"
            yield self._report(name, 0x1A, (record,), self._availability, record, codes)
        yield self._report("Read supported trouble codes", 0x0A, (), self._availability, codes)
        coding = described(Field(name="counter", kind=Coding.SIGNED, size_bytes=1))
        counter = value("counter", simple("fault detection counter", coding), 1)
        counted = dictionary.structure("trouble code with counter", (self._code, counter))
        counters = value("counters", dictionary.repeated("fault detection counters", counted))
        yield self._report("Read fault detection counters", 0x14, (), counters)
        if self.table.has_obd(Profile.UDS):
            yield from self._emission_reports(codes)

    def _emission_reports(self, codes: Part) -> Iterator[Service]:
        """Yield the reports of SAE J1979-2: codes by masks, and those that no client can clear."""
        dictionary, available = self.dictionary, self._availability
        group = constant("group", trouble.EMISSION_GROUP)
        byte = self.hexadecimal("mask of status and severity")
        masks = value("status_mask", byte, 1), value("severity_mask", byte, 1)
        coding = worded({trouble.CODE_FORMAT_J2012: "SAE J2012-DA"})
        form = value("format", dictionary.simple("format of trouble codes of OBD", coding), 1)
        severity = value("severity", self.hexadecimal("severity"), 1)
        entry = dictionary.structure("trouble code with severity", (severity, self._code, self._status))
        found = value("trouble_codes", dictionary.repeated("trouble codes with severity", entry))
        every = constant("severity_availability", trouble.ALL_SEVERITIES)
        yield self._report("Read trouble codes of OBD", 0x42, (group, *masks), group, available, every, form, found)
        readiness = constant("readiness_group", 0 if self.table.obd is None else self.table.obd.readiness_group)
        name = "Read trouble codes of a readiness group"
        yield self._report(name, 0x56, (group, readiness), group, available, form, readiness, codes)
        yield self._report("Read permanent trouble codes", 0x55, (group,), group, available, form, codes)

    def _snapshots(self) -> Service:
        table, dictionary = self.table, self.dictionary
        wanted = {number for entry in table.troubles.values() for number in table.snapshot_of(entry)}
        cases = {number: structure for number, structure in self._structures.items() if number in wanted}
        switch = dictionary.switched("snapshot by identifier", self._number, 2, cases)
        datum = dictionary.structure("snapshot datum", (value("datum", switch),))
        size = dictionary.simple("number of snapshot data", unsigned(1))
        content = value("data", dictionary.counted("snapshot data", datum, size))
        record = dictionary.structure("snapshot", (self._record, content))
        asked = value("record", dictionary.simple("snapshot to read", worded(_SNAPSHOTS)), 1)
        found = value("snapshots", dictionary.repeated("snapshots", record))
        return self._report("Read snapshots", 0x04, (self._code, asked), self._code, self._status, found)

    def _extended(self) -> Service:
        dictionary, extended = self.dictionary, self.table.extended
        choices = {record.number: record.name for record in extended.values()} | {trouble.ALL_RECORDS: "all"}
        if max(extended, default=0) >= trouble.FIRST_REGULATED:
            choices[trouble.ALL_REGULATED_RECORDS] = "all regulated"
        cases = {entry.number: dictionary.fields(f"record {entry.name}", entry.fields) for entry in extended.values()}
        number = dictionary.simple("number of extended data", unsigned(1))
        switch = dictionary.switched("extended data by number", number, 1, cases)
        record = dictionary.structure("extended record", (value("record", switch),))
        asked = value("record", dictionary.simple("extended data to read", worded(choices)), 1)
        found = value("records", dictionary.repeated("extended data", record))
        return self._report("Read extended data", 0x06, (self._code, asked), self._code, self._status, found)


def _routine_states(routine: Routine, sub: int) -> tuple[int, ...]:
    """Return what may be answered: the status says whether results follow."""
    if sub == routines.STOP:
        return (routines.STOPPED,)
    if sub == routines.RESULTS:
        return routines.COMPLETED, routines.RUNNING, routines.STOPPED
    return (routines.COMPLETED, routines.STOPPED) if routine.is_awaited else (routines.RUNNING,)


class ObdServices(_Services):
    """Services 01 to 0A of SAE J1979, or the data of SAE J1979-2, which UDS reads."""

    def __init__(self, table: DiagnosticTable, described_obd: Obd, dictionary: Dictionary) -> None:
        super().__init__(table, dictionary)
        self._obd = described_obd
        self._bitmap = value("supported", dictionary.simple("bitmap of what is there", raw(4)), 4)
        self._pids = {pid.number: self._pid(pid) for pid in described_obd.pids.values()}
        self._infos = {info.number: self._info(info) for info in described_obd.infos.values()}

    def _pid(self, pid: Pid) -> Part:
        fields = tuple(replace(entry, source="") for entry in pid.fields)  # in OBD all bits set are a value like others
        size = sum(entry.size_bytes for entry in fields)
        return value(pid.name, self.dictionary.fields(f"OBD {pid.name}", fields), size)

    def _info(self, info: VehicleInfo) -> Part:
        is_text = bool(info.text) or (
            info.data is not None and self.table.data[info.data].fields[0].kind is Coding.TEXT
        )
        content = Field(name=info.name, kind=Coding.TEXT if is_text else Coding.BYTES, size_bytes=info.size_bytes)
        return value(info.name, self.dictionary.simple(f"OBD {info.name}", described(content)), info.size_bytes)

    def by_identifier(self) -> Iterator[Service]:
        """Yield a service for each datum of SAE J1979-2: parameters F4xx, vehicle information F8xx."""
        known = self._obd
        found = {data.PID_DATA | pid.number: (pid.name, self._pids[pid.number]) for pid in known.pids.values()}
        found |= {data.INFO_DATA | info.number: (info.name, self._infos[info.number]) for info in known.infos.values()}
        for page, numbers in ((data.PID_DATA, known.pids), (data.INFO_DATA, known.infos)):
            found |= {page | first: (f"supported {page | first:04X}", self._bitmap) for first in _bitmaps(numbers)}
        for number, (name, content) in found.items():
            begin = constant("identifier", number, 2, "ID")
            yield self.service(f"Read OBD {name}", Number.READ_DATA, "CURRENTDATA", (begin,), (begin, content))

    def __iter__(self) -> Iterator[Service]:
        yield from self._parameters()
        yield from self._freeze_frame()
        yield from self._codes()
        yield self.service("Clear trouble codes of OBD", ObdService.CLEAR, "FAULTCLEAR")
        yield from self._monitors()
        yield from self._information()

    def _supported(self, what: str, number: int, known: Mapping[int, object], *more: Part) -> Iterator[Service]:
        """Yield the services that read which numbers are there; ``more`` comes behind the number, back and forth."""
        for first in _bitmaps(known):
            begin = (constant("number", first, semantic="ID"), *more)
            name = f"Read supported {what} {first:02X}"
            yield self.service(name, number, "IDENTIFICATION", begin, (*begin, self._bitmap))

    def _several(self, name: str, number: int, semantic: str, what: str, asked: Parts, most: int) -> Service:
        structure = self.dictionary.structure(f"asked {what}", asked)
        request = (value("parameters", self.dictionary.repeated(f"asked {what}s", structure, most, 1)),)
        response = (value("parameters", self.dictionary.simple(f"{what}s with their numbers", rest(1))),)
        return self.service(name, number, semantic, request, response)

    def _parameters(self) -> Iterator[Service]:
        number, kind = ObdService.CURRENT_DATA, "CURRENTDATA"
        for pid in self._obd.pids.values():
            begin = constant("number", pid.number, semantic="ID")
            yield self.service(f"Read {pid.name}", number, kind, (begin,), (begin, self._pids[pid.number]))
        yield from self._supported("parameters", number, self._obd.pids)
        asked = (value("number", self.hexadecimal("number of a parameter"), 1),)
        yield self._several("Read several data", number, kind, "parameter", asked, obd.MOST_PIDS)

    def _freeze_frame(self) -> Iterator[Service]:
        number, kind, frame = ObdService.FREEZE_FRAME, "FAULTREAD", constant("frame", obd.FRAME)
        frozen = {pid.number: pid for pid in self._obd.pids.values() if pid.is_frozen}
        for pid in frozen.values():
            begin = constant("number", pid.number, semantic="ID"), frame
            yield self.service(f"Read frozen {pid.name}", number, kind, begin, (*begin, self._pids[pid.number]))
        code = value("code", self.hexadecimal("code of the freeze frame", _CODE_BYTES), _CODE_BYTES)
        begin = constant("number", obd.CODE_OF_FRAME, semantic="ID"), frame
        yield self.service("Read code of the freeze frame", number, kind, begin, (*begin, code))
        yield from self._supported("frozen parameters", number, {obd.CODE_OF_FRAME: code, **frozen}, frame)
        asked = (
            value("number", self.hexadecimal("number of a frozen parameter"), 1),
            value("frame", self.hexadecimal("number of a frame"), 1),
        )
        name = "Read several frozen parameters"
        yield self._several(name, number, kind, "frozen parameter", asked, obd.MOST_FROZEN_PIDS)

    def _codes(self) -> Iterator[Service]:
        troubles = tuple({entry.code: entry for entry in self.table.troubles.values()}.values())
        name, dictionary = "trouble code", self.dictionary
        code = dictionary.codes(name, troubles, _CODE_BYTES) if troubles else self.hexadecimal(name, _CODE_BYTES)
        item = dictionary.structure("stored trouble code", (value("trouble_code", code, _CODE_BYTES),))
        count = dictionary.simple("number of trouble codes", unsigned(1))
        found = (value("trouble_codes", dictionary.counted("trouble codes", item, count)),)
        for kind, number in (
            ("confirmed", ObdService.CONFIRMED_CODES),
            ("pending", ObdService.PENDING_CODES),
            ("permanent", ObdService.PERMANENT_CODES),
        ):
            yield self.service(f"Read {kind} trouble codes", number, "FAULTREAD", (), found)

    def _monitors(self) -> Iterator[Service]:
        number = ObdService.TEST_RESULTS
        coding = described(Field(name="result", kind=Coding.SIGNED, size_bytes=2))
        result = self.dictionary.simple("result of a test", coding)
        content = (
            constant("test", obd.COUNTER_TEST),
            constant("unit_and_scaling", obd.SIGNED_COUNT),
            *(value(name, result, 2) for name in ("result", "least", "most")),
        )
        for monitor in self._obd.monitors.values():
            begin = constant("number", monitor.number, semantic="ID")
            yield self.service(f"Read test of {monitor.code}", number, "FAULTREAD", (begin,), (begin, *content))
        yield from self._supported("tests", number, self._obd.monitors)

    def _information(self) -> Iterator[Service]:
        number = ObdService.VEHICLE_INFORMATION
        for info in self._obd.infos.values():
            begin = constant("number", info.number, semantic="ID")
            response = (begin, constant("items", obd.ONE_ITEM), self._infos[info.number])
            yield self.service(f"Read {info.name}", number, "IDENTIFICATION", (begin,), response)
        yield from self._supported("vehicle information", number, self._obd.infos)


def _bitmaps(known: Mapping[int, object]) -> Iterator[int]:
    return (first for first in range(0, 0x100, BLOCK) if supported(known, first) is not None)
