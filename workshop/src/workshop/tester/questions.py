"""Questions to one controller and their answers: trouble codes, clearing them, data, routines."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from diag_service.errors import (
    ConfigError,
    ControllerError,
    MalformedAnswerError,
    PendingError,
    RefusedError,
    SilentError,
)
from workshop.tester.addresses import check_number
from workshop.tester.answers import (
    BY_MASK,
    CLEAR,
    DEFAULT_SESSION,
    EXTENDED,
    READ_DATA,
    READ_TROUBLE,
    ROUTINE,
    SECURITY,
    SESSION,
    SNAPSHOTS,
    SUPPORTED,
    hex_text,
    refusal_text,
    request_text,
)
from workshop.tester.description import SYSTEMS, UNKNOWN, Description, Values, fields_size_bytes, read_fields, shipped
from workshop.tester.trouble import CODE_BYTES, FailureRecord, TroubleCode, read_codes, read_extended, read_snapshots

if TYPE_CHECKING:
    from workshop.tester.dialogue import Dialogue


def recognise(tester: "Dialogue", description: Description = UNKNOWN) -> Description:
    """Return the given description, or the shipped one that fits, or that of the standard data.

    Without a given one it reads the identity of the shipped ones.
    """
    if description is not UNKNOWN:
        return description
    for described in shipped():
        if described.identity is None:
            continue
        try:
            response = tester.ask(bytes([READ_DATA]) + described.identity.number.to_bytes(2, "big"))
        except PendingError:  # the next request would wait as long
            raise
        except ControllerError:  # the next question reports that
            continue
        if response[3:].rstrip(b"\0 ").decode("latin-1") == described.identity.text:
            return described.description
    return UNKNOWN


ALL_RECORDS: Final = 0xFF
FAILED_MASK: Final = 0xAF  # all status bits but those of tests that have not run
FAILED: Final = bytes([READ_TROUBLE, BY_MASK, FAILED_MASK])
START, STOP, RESULTS = 0x01, 0x02, 0x03
ACTIONS: Final = {"start": START, "stop": STOP, "results": RESULTS}


@dataclass(frozen=True, slots=True, kw_only=True)
class DataAnswer:
    """One datum: its bytes and values, or why there are none."""

    number: int
    name: str
    data: bytes = b""
    values: Values | None = None
    refusal: int | None = None
    fault: str = ""  # violation of the standard in the answer

    @property
    def refusal_text(self) -> str:
        """The refusal in words, empty without one."""
        return "" if self.refusal is None else refusal_text(self.refusal)

    @property
    def trouble(self) -> str:
        """Why there are no values, empty if there are."""
        return self.refusal_text or self.fault


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineAnswer:
    """The answer of a routine."""

    number: int
    name: str
    action: str
    data: bytes
    values: Values


def trouble_request(mask: int) -> bytes:
    """Return the request for codes with a status bit of the mask; 0: for all supported codes."""
    return bytes([READ_TROUBLE, BY_MASK, mask]) if mask else bytes([READ_TROUBLE, SUPPORTED])


def read_troubles(
    tester: "Dialogue", description: Description, request: bytes = FAILED, *, has_details: bool = True
) -> tuple[TroubleCode, ...]:
    """Return the trouble codes of a `trouble_request`.

    With details each has its snapshots and extended data, as far as the controller answers.
    """
    codes = read_codes(tester.ask(request), description)
    if not has_details:
        return codes
    details = _Details(tester, description)
    return tuple(map(details.with_details, codes))


_Read = Callable[[bytes, Description], tuple[FailureRecord, ...]]


class _Details:
    """Reads snapshots and extended data; a refusal is no error, and after silence a kind is not read any more."""

    def __init__(self, tester: "Dialogue", description: Description) -> None:
        self._tester, self._description = tester, description
        self._silent: dict[int, str] = {}  # by kind: why it is not read any more

    def with_details(self, code: TroubleCode) -> TroubleCode:
        snapshots, fault = self._read_records(SNAPSHOTS, code.number, read_snapshots)
        extended, extended_fault = self._read_records(EXTENDED, code.number, read_extended)
        return replace(code, snapshots=snapshots, extended=extended, fault=fault or extended_fault)

    def _read_records(self, kind: int, number: int, read: _Read) -> tuple[tuple[FailureRecord, ...], str]:
        if kind in self._silent:
            return (), self._silent[kind]
        try:
            answer = self._tester.ask_or_refusal(
                bytes([READ_TROUBLE, kind]) + number.to_bytes(3, "big") + bytes([ALL_RECORDS])
            )
            return () if isinstance(answer, RefusedError) else read(answer, self._description), ""
        except MalformedAnswerError as exc:
            return (), str(exc)
        except SilentError as exc:
            self._silent[kind] = str(exc)
            return (), str(exc)


def read_datum(tester: "Dialogue", description: Description, number: int) -> DataAnswer:
    """Read one datum."""
    name = description.data_name(number)
    try:
        answer = tester.ask_or_refusal(bytes([READ_DATA]) + number.to_bytes(2, "big"))
    except MalformedAnswerError as exc:
        return DataAnswer(number=number, name=name, fault=str(exc))
    if isinstance(answer, RefusedError):
        return DataAnswer(number=number, name=name, refusal=answer.code)
    data = answer[3:]
    if (size := description.size_bytes(number)) not in {None, len(data)}:
        return DataAnswer(
            number=number,
            name=name,
            fault=f"its length in bytes is described as {size}, and it came as {hex_text(data)}",
        )
    return DataAnswer(number=number, name=name, data=data, values=description.values(number, data))


ALL: Final = "all"
GROUPS: Final = {ALL: 0xFFFFFF, "obd": 0xFFFF33}  # ISO 14229-1, annex D.1
_CODE: Final = re.compile(r"([PCBU])([0-3][0-9A-F]{3})(?:-([0-9A-F]{2}))?", re.IGNORECASE)
_NUMBER: Final = re.compile(r"(?:0x)?([0-9A-F]{6})", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class CodeGroup:
    """Trouble codes to clear: a number of three bytes, or a code with any failure type."""

    word: str
    number: int | None  # None: the stored codes with this word

    def numbers(self, codes: Sequence[TroubleCode]) -> tuple[int, ...]:
        """Return the groups to clear, by the codes of the controller.

        Raises ConfigError if it has no such code.
        """
        if self.number is not None:
            return (self.number,)
        numbers = tuple(code.number for code in codes if code.code == self.word)
        if not numbers:
            known = ", ".join(dict.fromkeys(code.code for code in codes)) or "none"
            raise ConfigError(f"{self.word} is not among the trouble codes that the controller reports: {known}")
        return numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Clearing:
    """Cleared groups, and the codes before and after."""

    groups: tuple[int, ...]  # empty: clearing was not agreed to
    before: tuple[TroubleCode, ...]
    after: tuple[TroubleCode, ...]

    @property
    def gone(self) -> tuple[TroubleCode, ...]:
        left = {code.number for code in self.after}
        return tuple(code for code in self.before if code.number not in left)


def parse_group(text: str, name: str = "--clear") -> CodeGroup:
    """Return the group that ``all``, ``obd``, ``P0811``, ``P0811-07`` or ``081107`` names; raises ConfigError."""
    if (number := GROUPS.get(text.casefold())) is not None:
        return CodeGroup(word=text.casefold(), number=number)
    if match := _NUMBER.fullmatch(text):
        return CodeGroup(word=match[1].upper(), number=int(match[1], 16))
    if not (match := _CODE.fullmatch(text)):
        raise ConfigError(f"{name} must be all, obd, a code such as P0811 or P0811-07, or three bytes, got {text!r}")
    system, digits, failure_type = match[1].upper(), match[2].upper(), match[3]
    if failure_type is None:
        return CodeGroup(word=system + digits, number=None)
    upper = SYSTEMS.index(system) << 14 | int(digits, 16)
    return CodeGroup(word=text.upper(), number=upper << 8 | int(failure_type, 16))


def clear_request(number: int) -> bytes:
    return bytes([CLEAR]) + number.to_bytes(CODE_BYTES, "big")


EXTENDED_SESSION: Final = 0x03
LARGEST_SESSION: Final = 0x7F
LARGEST_LEVEL: Final = 0x7E
PATIENCE_S: Final = 600.0  # with response pending (78): a routine moves parts and may wait for warm ones
AnswerT_co = TypeVar("AnswerT_co", covariant=True)


class Question(Protocol[AnswerT_co]):
    """A question to one controller."""

    def requests(self, description: Description) -> list[str]:
        """Return the requests, for people; raises ConfigError."""

    def ask(self, tester: "Dialogue", description: Description) -> AnswerT_co:
        """Ask and return the answer; raises ConfigError, and what a `Dialogue` raises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TroubleQuestion:
    """Trouble codes with a status bit of the mask; 0: all supported codes."""

    mask: int = FAILED_MASK
    has_details: bool = True  # snapshots and extended data

    def __post_init__(self) -> None:
        check_number("mask", self.mask, 0xFF)

    def requests(self, description: Description) -> list[str]:
        del description
        details = ["19 04 and 19 06: what was kept of each code"] if self.has_details else []
        return [f"{request_text(trouble_request(self.mask))}: the codes", *details]

    def ask(self, tester: "Dialogue", description: Description) -> tuple[TroubleCode, ...]:
        return read_troubles(tester, description, trouble_request(self.mask), has_details=self.has_details)


def always_agree(where: str, codes: Sequence[TroubleCode]) -> bool:
    """Return True: a Python program has decided before."""
    del where, codes
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class ClearQuestion:
    """Trouble codes to clear; those of the mask (0: all) are read before and after."""

    group: CodeGroup
    mask: int = FAILED_MASK
    session: int = DEFAULT_SESSION
    is_agreed: Callable[[str, Sequence[TroubleCode]], bool] = always_agree  # gets the controller and its codes

    def __post_init__(self) -> None:
        check_number("mask", self.mask, 0xFF)
        check_number("session", self.session, LARGEST_SESSION)

    def requests(self, description: Description) -> list[str]:
        del description
        group, reading = self.group, request_text(trouble_request(self.mask))
        clearing = f"{CLEAR:02X}: {group.word}" if group.number is None else request_text(clear_request(group.number))
        return [f"{reading}: the codes", *_entering(self.session), f"{clearing}: clear", f"{reading}: what is left"]

    def ask(self, tester: "Dialogue", description: Description) -> Clearing:
        """Clear the codes if that is agreed to; the question comes before the session, which ends by itself."""
        reading = trouble_request(self.mask)
        before = read_troubles(tester, description, reading, has_details=False)
        groups = self.group.numbers(before)
        if not self.is_agreed(tester.where, before):
            return Clearing(groups=(), before=before, after=before)
        with tester.session(self.session):
            for number in groups:
                tester.ask(clear_request(number))
        return Clearing(
            groups=groups, before=before, after=read_troubles(tester, description, reading, has_details=False)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class DataQuestion:
    """Data by hexadecimal number or by name; without any, all of the description."""

    words: tuple[str, ...] = ()
    session: int = DEFAULT_SESSION

    def __post_init__(self) -> None:
        check_number("session", self.session, LARGEST_SESSION)

    def requests(self, description: Description) -> list[str]:
        if self.words and description is UNKNOWN:
            return [*_entering(self.session), *(f"22: {word}" for word in self.words)]
        questions = (bytes([READ_DATA]) + number.to_bytes(2, "big") for number in self._numbers(description))
        return [*_entering(self.session), *map(request_text, questions)]

    def ask(self, tester: "Dialogue", description: Description) -> tuple[DataAnswer, ...]:
        with tester.session(self.session):
            return tuple(read_datum(tester, description, number) for number in self._numbers(description))

    def _numbers(self, description: Description) -> list[int]:
        return [description.find_data(word) for word in self.words] or sorted(description.data)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lock:
    """A security level and the mask of its key: seed XOR mask."""

    level: int  # odd: sub-function of the seed
    mask: bytes

    def __post_init__(self) -> None:
        if not (0 < self.level <= LARGEST_LEVEL and self.level % 2 and self.mask):
            raise ConfigError(f"a security level is odd, 1 to 7D in hexadecimal, and has a mask, got {self.level:X}")


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineQuestion:
    """A routine, by hexadecimal number or by name, to start or stop, or whose results to read."""

    routine: str
    action: str
    options: bytes = b""  # of the start
    session: int = EXTENDED_SESSION
    lock: Lock | None = None  # unlocked before

    def __post_init__(self) -> None:
        check_number("session", self.session, LARGEST_SESSION)
        if self.action not in ACTIONS:
            raise ConfigError(f"a routine takes {', '.join(ACTIONS)}, got {self.action!r}")
        if self.options and self.action != "start":
            raise ConfigError("options are for the start of a routine")

    def requests(self, description: Description) -> list[str]:
        unlocking = [] if self.lock is None else [f"{request_text(bytes([SECURITY, self.lock.level]))} and the key"]
        asked = bytes([ROUTINE, ACTIONS[self.action]])
        if description is UNKNOWN:
            question = f"{request_text(asked)}: {self.routine} {request_text(self.options)}".rstrip()
        else:
            number = description.find_routine(self.routine).to_bytes(2, "big")
            question = request_text(asked + number + self.options)
        return [*_entering(self.session), *unlocking, question]

    def ask(self, tester: "Dialogue", description: Description) -> RoutineAnswer:
        """Enter the session, unlock if needed, and ask."""
        number = description.find_routine(self.routine)
        with tester.patience(PATIENCE_S), tester.session(self.session):
            if self.lock is not None:
                tester.unlock(self.lock.level, self.lock.mask)
            request = bytes([ROUTINE, ACTIONS[self.action]]) + number.to_bytes(2, "big") + self.options
            data = tester.ask(request)[4:]
        routine = description.routines.get(number)
        fields = () if routine is None else routine.results
        if (size := fields_size_bytes(fields)) not in {None, len(data)}:
            if ACTIONS[self.action] == RESULTS:
                text = (
                    f"{tester.where}: the length in bytes of the results of routine {number:04X} is described as {size}"
                )
                raise MalformedAnswerError(f"{text}, and they came as {hex_text(data) or 'nothing'}")
            fields = ()  # the answer to a start may hold other bytes
        name = "" if routine is None else routine.name
        return RoutineAnswer(number=number, name=name, action=self.action, data=data, values=read_fields(fields, data))


def _entering(session: int) -> Iterable[str]:
    return () if session == DEFAULT_SESSION else (request_text(bytes([SESSION, session])),)
