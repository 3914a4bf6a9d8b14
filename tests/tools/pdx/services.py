"""Services as a tool offers them, made of a controller's table: for people a task, on the wire one kind of request."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from tests.tools.pdx.elements import (
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
from workshop.controller import descriptions, iso14229, memory
from workshop.controller.descriptions import AccessRule, Coding, DataIdentifier, DatumField, Pid, Routine, VehicleInfo
from workshop.controller.iso14229 import ObdService
from workshop.controller.iso14229 import Service as Number
from workshop.controller.services import data, obd, sessions, trouble
from workshop.controller.table import DiagnosticTable

_RESETS: Final = {1: "hard reset", 2: "ignition off and on", 3: "soft reset"}
_TRAFFIC: Final = ("enable receiving and sending", "enable receiving, disable sending",
                   "disable receiving, enable sending", "disable receiving and sending")  # fmt: skip
_MESSAGES: Final = {1: "normal messages", 2: "network management", 3: "normal messages and network management"}
_SETTINGS: Final = {sessions.CODES_ON: "trouble codes on", sessions.CODES_OFF: "trouble codes off"}
# Stacks for SOVD look for these words at the end of a name.
_ACTIONS: Final = {sessions.START: "Start", sessions.STOP: "Stop", sessions.RESULTS: "RequestResults"}
_STATUS_BITS: Final = (
    "test failed", "test failed this operation cycle", "pending", "confirmed", "test not completed since last clear",
    "test failed since last clear", "test not completed this operation cycle", "warning indicator requested",
)  # fmt: skip
_SNAPSHOTS: Final = {
    memory.FIRST_RECORD: "first failure", memory.LATEST_RECORD: "latest failure", trouble.ALL_RECORDS: "all",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class OdxService:
    """One service: its request, its responses, and when it may be asked."""

    name: str
    number: int  # of ISO 14229-1 or SAE J1979
    semantic: str
    request: Parts  # after the service's number
    responses: tuple[Parts, ...]  # likewise; one of them comes
    access: AccessRule
    has_sub_function: bool = False
    enters: int | None = None  # a session
    unlocks: int | None = None  # a security level
    resets: bool = False


class _Services:
    """What services of UDS and OBD have in common."""

    def __init__(self, table: DiagnosticTable, dictionary: Dictionary) -> None:
        self.table, self.dictionary = table, dictionary

    def service(
        self, name: str, number: int, semantic: str, request: Parts = (), *responses: Parts, sub: int | None = None,
        access: AccessRule | None = None, **effects: Any,  # noqa: ANN401 - as a service has them
    ) -> OdxService:  # fmt: skip
        """Return a service; without responses it has an empty one, and each repeats a sub-function."""
        head: Parts = () if sub is None else (constant("sub_function", sub, semantic="SUBFUNCTION"),)
        answers = tuple((*head, *response) for response in responses or ((),))
        return OdxService(name=name, number=number, semantic=semantic, request=(*head, *request), responses=answers,
                       access=self._access(number, access), has_sub_function=sub is not None, **effects)  # fmt: skip

    def _access(self, number: int, own: AccessRule | None) -> AccessRule:
        """Return who may use a service, or do with it what needs an access of its own."""
        service = self.table.services.get(number)
        if service is None:  # of OBD
            return AccessRule(sessions=tuple(self.table.sessions))
        own = own or AccessRule(sessions=service.sessions)
        both = tuple(level for level in service.levels if level in own.levels or not own.levels)
        allowed = tuple(session for session in service.sessions if session in own.sessions)
        conditions = (*service.conditions, *own.conditions)
        return AccessRule(sessions=allowed, levels=both if service.levels else own.levels, conditions=conditions)

    def hexadecimal(self, name: str, what: str, size_bytes: int = 1) -> Part:
        """Return a plain number that tools show in base 16."""
        return value(name, self.dictionary.simple(what, unsigned(size_bytes, is_hexadecimal=True)), size_bytes)

    def number(self, name: str, what: str, size_bytes: int = 1, meanings: Mapping[int, str] | None = None) -> Part:
        """Return a number, or what it stands for."""
        coding = unsigned(size_bytes) if meanings is None else worded(meanings, 8 * size_bytes)
        return value(name, self.dictionary.simple(what, coding), size_bytes)


class UdsServices(_Services):
    """The services of ISO 14229-1 that a table has."""

    def __init__(self, table: DiagnosticTable, dictionary: Dictionary) -> None:
        super().__init__(table, dictionary)
        self._structures = {datum.number: dictionary.fields(datum.name, datum.fields) for datum in table.data.values()}
        self._number = self.hexadecimal("number", "number of a datum", 2)
        self._low = self.hexadecimal("number", "lower byte of a number")
        labels = {datum.number: f"{datum.number:04X} {datum.name}" for datum in table.data.values()}
        self._choice = self.number("identifier", "data", 2, labels) if labels else self._number
        self._code = dictionary.code_part("trouble_code", "trouble code", tuple(table.troubles.values()), 3)
        flags = dictionary.flags("status of a trouble code", _STATUS_BITS)
        self._status, self._availability = value("status", flags, 1), value("status_availability", flags, 1)
        self._record = self.number("record", "number of a record")
        self._page = constant("page", data.DEFINABLE_PAGE, semantic="ID")  # upper byte of data that clients may define

    def __iter__(self) -> Iterator[OdxService]:
        makers = {
            Number.SESSION_CONTROL: self._sessions, Number.ECU_RESET: self._resets, Number.CLEAR_CODES: self._clearing,
            Number.READ_CODES: self._trouble_codes, Number.READ_DATA: self._reading,
            Number.SECURITY_ACCESS: self._security, Number.COMMUNICATION_CONTROL: self._communication,
            Number.DEFINE_DATA: self._defining,
            Number.WRITE_DATA: self._writing, Number.ROUTINE_CONTROL: self._routines,
            Number.TESTER_PRESENT: self._presence, Number.CONTROL_CODE_SETTING: self._settings,
        }  # fmt: skip
        for number, make in makers.items():
            yield from make(number) if number in self.table.services else ()

    def _sessions(self, number: int) -> Iterator[OdxService]:
        times = tuple(
            value(name, self.dictionary.simple(name, scaled(2, step), unit="ms"), 2)
            for name, step in (("P2", 1.0), ("P2_star", 10.0))
        )
        for session in self.table.sessions.values():
            name, sub, access = (
                f"Start session {session.name}",
                session.number,
                AccessRule(sessions=session.from_sessions),
            )
            yield self.service(name, number, "SESSION", (), times, sub=sub, access=access, enters=sub)

    def _resets(self, number: int) -> Iterator[OdxService]:
        for sub, name in _RESETS.items():
            yield self.service(f"Reset {name}", number, "RESET", sub=sub, resets=True)

    def _security(self, number: int) -> Iterator[OdxService]:
        for level in self.table.levels.values():
            access, own = AccessRule(sessions=level.sessions), level.number
            content = self.dictionary.simple(f"seed and key {level.name}", raw(level.seed_bytes))
            seed, key = ((value(name, content, level.seed_bytes),) for name in ("seed", "key"))
            yield self.service(f"Request seed {level.name}", number, "SECURITY", (), seed, sub=own, access=access)
            name = f"Send key {level.name}"
            yield self.service(name, number, "SECURITY", key, sub=own + 1, access=access, unlocks=own)

    def _communication(self, number: int) -> Iterator[OdxService]:
        kind = (self.number("messages", "communication type", meanings=_MESSAGES),)
        for sub, name in enumerate(_TRAFFIC):
            yield self.service(f"Communication {name}", number, "COMMUNICATION", kind, sub=sub)

    def _presence(self, number: int) -> Iterator[OdxService]:
        yield self.service("Tester present", number, "TESTERPRESENT", sub=0)

    def _settings(self, number: int) -> Iterator[OdxService]:
        for sub, name in _SETTINGS.items():
            yield self.service(f"Updating of {name}", number, "CONTROL", sub=sub)

    def _content(self, datum: DataIdentifier) -> Parts:
        return (value(datum.name, self._structures[datum.number], datum.size_bytes),)

    def _reading(self, number: int) -> Iterator[OdxService]:
        dictionary, most, kind = self.dictionary, self.table.limits.most_data, "CURRENTDATA"
        for datum in self.table.data.values():
            begin = (constant("identifier", datum.number, 2, "ID"),)
            semantic, answer = kind if datum.initial is None else "IDENTIFICATION", (*begin, *self._content(datum))
            yield self.service(f"Read {datum.name}", number, semantic, begin, answer, access=datum.read)
        left = value("bytes", dictionary.simple("bytes of a defined datum", rest(1)))
        asked = dictionary.structure("asked datum", (renamed(self._choice, "identifier"),))
        other = dictionary.structure("other data", (left,))
        switch = dictionary.switched("read data by identifier", self._number, self._structures, other)
        found = dictionary.structure("read datum", (value("datum", switch),))
        several, answered = (
            (value("data", dictionary.repeated(name, part, most, 1)),)
            for name, part in (("asked data", asked), ("read data", found))
        )
        yield self.service("Read several data", number, kind, several, answered)
        answer = (self._page, echo("number", 2, 1), left)
        yield self.service("Read defined data", number, kind, (self._page, self._low), answer)

    def _defining(self, number: int) -> Iterator[OdxService]:
        kind, dictionary = "DYN-DEF-MESSAGE", self.dictionary
        size = self.number("bytes", "number of bytes")
        parts = renamed(self._choice, "source"), renamed(size, "first_byte"), size
        piece = dictionary.structure("piece of a datum", parts)
        pieces = value("pieces", dictionary.repeated("pieces of data", piece, self.table.limits.most_pieces, 1))
        asked, response = (self._page, self._low), (self._page, echo("number", 3, 1))
        define, clear = data.DEFINE_BY_IDENTIFIER, data.CLEAR_DEFINITION
        yield self.service("Define data", number, kind, (*asked, pieces), response, sub=define)
        yield self.service("Forget defined data", number, kind, asked, response, sub=clear)
        yield self.service("Forget all defined data", number, kind, sub=data.CLEAR_DEFINITION)

    def _writing(self, number: int) -> Iterator[OdxService]:
        for datum in self.table.data.values():
            if datum.write is not None:
                begin = (constant("identifier", datum.number, 2, "ID"),)
                whole = (*begin, *self._content(datum))
                yield self.service(f"Write {datum.name}", number, "STOREDDATA", whole, begin, access=datum.write)

    def _routines(self, number: int) -> Iterator[OdxService]:
        for routine in self.table.routines.values():
            options = self.dictionary.field_parts(f"option of {routine.name}", routine.options)
            results = self.dictionary.field_parts(f"result of {routine.name}", routine.results)
            begin = constant("identifier", routine.number, 2, "ID")
            for sub, verb in _ACTIONS.items():
                responses = (
                    (begin, constant("status", status), *(results if status == sessions.COMPLETED else ()))
                    for status in _routine_states(routine, sub)
                )
                asked, name = (begin, *(options if sub == sessions.START else ())), f"{routine.name} {verb}"
                if sub != sessions.STOP or routine.can_be_stopped:
                    yield self.service(name, number, "ROUTINE", asked, *responses, sub=sub, access=routine.access)

    def _clearing(self, number: int) -> Iterator[OdxService]:
        groups = {"Clear all trouble codes": constant("group", iso14229.ALL_CODES, 3)}
        if self.table.troubles:
            groups["Clear trouble code"] = self._code
        for name, group in groups.items():
            yield self.service(name, number, "FAULTCLEAR", (group,))

    def _report(self, name: str, sub: int, request: Parts, *response: Part) -> OdxService:
        return self.service(name, Number.READ_CODES, "FAULTREAD", request, response, sub=sub)

    def _list(self, name: str, many: str, item: str, *parts: Part) -> Part:
        """Return a parameter of several entries of these parts."""
        return value(name, self.dictionary.repeated(many, self.dictionary.structure(item, parts)))

    def _trouble_codes(self, _: int) -> Iterator[OdxService]:
        codes = self._list("trouble_codes", "trouble codes", "trouble code with status", self._code, self._status)
        mask, available = (self.hexadecimal("status_mask", "mask of status"),), self._availability
        form = self.number("format", "format of trouble codes", meanings={trouble.CODE_FORMAT: "SAE J2012-DA"})
        count = self.number("count", "count of trouble codes", 2)
        yield self._report("Count trouble codes by status", 0x01, mask, available, form, count)
        yield self._report("Read trouble codes by status", 0x02, mask, available, codes)
        names = self._list("snapshots", "names of snapshots", "trouble code with record", self._code, self._record)
        yield self._report("Read names of snapshots", 0x03, (), names)
        if self.table.troubles:
            yield self._snapshots()
            yield self._extended()
        yield self._report("Read supported trouble codes", 0x0A, (), available, codes)
        coding = described(DatumField(name="counter", kind=Coding.SIGNED, size_bytes=1))
        counter = value("counter", self.dictionary.simple("fault detection counter", coding), 1)
        counters = self._list("counters", "fault detection counters", "trouble code with counter", self._code, counter)
        yield self._report("Read fault detection counters", 0x14, (), counters)

    def _snapshots(self) -> OdxService:
        table, dictionary = self.table, self.dictionary
        cases = {number: structure for number, structure in self._structures.items() if number in table.snapshot}
        switch = dictionary.switched("snapshot by identifier", self._number, cases)
        datum = dictionary.structure("snapshot datum", (value("datum", switch),))
        count = dictionary.simple("number of snapshot data", unsigned(1))
        content = value("data", dictionary.counted("snapshot data", datum, count))
        record = dictionary.structure("snapshot", (self._record, content))
        asked = self.number("record", "snapshot to read", meanings=_SNAPSHOTS)
        found = value("snapshots", dictionary.repeated("snapshots", record))
        return self._report("Read snapshots", 0x04, (self._code, asked), self._code, self._status, found)

    def _extended(self) -> OdxService:
        dictionary, extended = self.dictionary, self.table.extended
        choices = {record.number: record.name for record in extended.values()} | {trouble.ALL_RECORDS: "all"}
        cases = {entry.number: dictionary.fields(f"record {entry.name}", entry.fields) for entry in extended.values()}
        switch = dictionary.switched("extended data by number", self.number("", "number of extended data"), cases)
        record = dictionary.structure("extended record", (value("record", switch),))
        asked = self.number("record", "extended data to read", meanings=choices)
        found = value("records", dictionary.repeated("extended data", record))
        return self._report("Read extended data", 0x06, (self._code, asked), self._code, self._status, found)


def renamed(part: Part, name: str) -> Part:
    """Return the same kind of parameter with another name."""
    return replace(part[0], short_name=name), part[1]


def _routine_states(routine: Routine, sub: int) -> tuple[int, ...]:
    """Return what may be answered: the status says whether results follow."""
    if sub == sessions.STOP:
        return (sessions.STOPPED,)
    if sub == sessions.RESULTS:
        return sessions.COMPLETED, sessions.RUNNING, sessions.STOPPED
    return (sessions.COMPLETED, sessions.STOPPED) if routine.is_awaited else (sessions.RUNNING,)


class ObdServices(_Services):
    """Services 01 to 0A of SAE J1979."""

    def __init__(self, table: DiagnosticTable, known: descriptions.Obd, dictionary: Dictionary) -> None:
        super().__init__(table, dictionary)
        self._obd = known
        self._bitmap = value("supported", dictionary.simple("bitmap of what is there", raw(4)), 4)
        self._pids = {pid.number: self._pid(pid) for pid in known.pids.values()}
        self._infos = {info.number: self._info(info) for info in known.infos.values()}

    def _pid(self, pid: Pid) -> Part:
        fields = tuple(replace(entry, source="") for entry in pid.fields)  # in OBD all bits set are a value like others
        size = sum(entry.size_bytes for entry in fields)
        return value(pid.name, self.dictionary.fields(f"OBD {pid.name}", fields), size)

    def _info(self, info: VehicleInfo) -> Part:
        kind = self.table.data[info.data].fields[0].kind if info.data is not None else Coding.BYTES
        is_text = bool(info.text) or kind is Coding.TEXT
        content = DatumField(name=info.name, kind=Coding.TEXT if is_text else Coding.BYTES, size_bytes=info.size_bytes)
        return value(info.name, self.dictionary.simple(f"OBD {info.name}", described(content)), info.size_bytes)

    def __iter__(self) -> Iterator[OdxService]:
        yield from self._parameters()
        yield from self._freeze_frame()
        yield from self._codes()
        yield self.service("Clear trouble codes of OBD", ObdService.CLEAR, "FAULTCLEAR")
        yield from self._monitors()
        for info in self._obd.infos.values():
            content = constant("items", obd.ONE_ITEM), self._infos[info.number]
            yield self._one(info.name, ObdService.VEHICLE_INFORMATION, "IDENTIFICATION", info.number, (), *content)
        yield from self._supported("vehicle information", ObdService.VEHICLE_INFORMATION, self._obd.infos)

    def _one(self, name: str, number: int, kind: str, what: int, more: Parts, *content: Part) -> OdxService:
        """Return the service that reads one number; ``more`` comes behind it, back and forth."""
        begin = (constant("number", what, semantic="ID"), *more)
        return self.service(f"Read {name}", number, kind, begin, (*begin, *content))

    def _supported(self, what: str, number: int, known: Mapping[int, object], *more: Part) -> Iterator[OdxService]:
        """Yield the services that read which numbers are there."""
        for first in _bitmaps(known):
            yield self._one(f"supported {what} {first:02X}", number, "IDENTIFICATION", first, more, self._bitmap)

    def _several(self, name: str, number: int, semantic: str, what: str, asked: Parts, most: int) -> OdxService:
        structure = self.dictionary.structure(f"asked {what}", asked)
        request = (value("parameters", self.dictionary.repeated(f"asked {what}s", structure, most, 1)),)
        response = (value("parameters", self.dictionary.simple(f"{what}s with their numbers", rest(1))),)
        return self.service(name, number, semantic, request, response)

    def _parameters(self) -> Iterator[OdxService]:
        number, kind = ObdService.CURRENT_DATA, "CURRENTDATA"
        for pid in self._obd.pids.values():
            yield self._one(pid.name, number, kind, pid.number, (), self._pids[pid.number])
        yield from self._supported("parameters", number, self._obd.pids)
        asked = (self.hexadecimal("number", "number of a parameter"),)
        yield self._several("Read several data", number, kind, "parameter", asked, obd.MOST_PIDS)

    def _freeze_frame(self) -> Iterator[OdxService]:
        number, kind, frame = ObdService.FREEZE_FRAME, "FAULTREAD", constant("frame", obd.FRAME)
        frozen = {pid.number: pid for pid in self._obd.pids.values() if pid.is_frozen}
        for pid in frozen.values():
            yield self._one(f"frozen {pid.name}", number, kind, pid.number, (frame,), self._pids[pid.number])
        code = self.hexadecimal("code", "code of the freeze frame", 2)
        yield self._one("code of the freeze frame", number, kind, obd.CODE_OF_FRAME, (frame,), code)
        yield from self._supported("frozen parameters", number, {obd.CODE_OF_FRAME: code, **frozen}, frame)
        which = self.hexadecimal("number", "number of a frozen parameter")
        asked, name = (which, self.hexadecimal("frame", "number of a frame")), "Read several frozen parameters"
        yield self._several(name, number, kind, "frozen parameter", asked, obd.MOST_FROZEN_PIDS)

    def _codes(self) -> Iterator[OdxService]:
        troubles = tuple({entry.code: entry for entry in self.table.troubles.values()}.values())
        item = self.dictionary.code_part("trouble_code", "trouble code", troubles, 2)
        stored = self.dictionary.structure("stored trouble code", (item,))
        count = self.dictionary.simple("number of trouble codes", unsigned(1))
        found = (value("trouble_codes", self.dictionary.counted("trouble codes", stored, count)),)
        for kind in ("confirmed", "pending", "permanent"):
            number = ObdService[f"{kind.upper()}_CODES"]
            yield self.service(f"Read {kind} trouble codes", number, "FAULTREAD", (), found)

    def _monitors(self) -> Iterator[OdxService]:
        coding = described(DatumField(name="result", kind=Coding.SIGNED, size_bytes=2))
        result = self.dictionary.simple("result of a test", coding)
        begin = constant("test", obd.COUNTER_TEST), constant("unit_and_scaling", obd.SIGNED_COUNT)
        content = (*begin, *(value(name, result, 2) for name in ("result", "least", "most")))
        for monitor in self._obd.monitors.values():
            name = f"test of {monitor.code}"
            yield self._one(name, ObdService.TEST_RESULTS, "FAULTREAD", monitor.number, (), *content)
        yield from self._supported("tests", ObdService.TEST_RESULTS, self._obd.monitors)


def _bitmaps(known: Mapping[int, object]) -> Iterator[int]:
    return (first for first in range(0, 0x100, descriptions.BLOCK) if descriptions.supported(known, first) is not None)
