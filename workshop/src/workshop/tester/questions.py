"""What one controller can be asked, as values and answers: trouble codes, that it forgets them, data, routines."""

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
    refusal_text,
    request_text,
    shown,
)
from workshop.tester.description import SYSTEMS, UNKNOWN, Description, Values, fields_size_bytes, read_fields, shipped
from workshop.tester.trouble import CODE_BYTES, FailureRecord, TroubleCode, read_codes, read_extended, read_snapshots

if TYPE_CHECKING:
    from workshop.tester.dialogue import Dialogue


def recognised(tester: "Dialogue", description: Description = UNKNOWN) -> Description:
    """Return a description; without one the shipped one that fits, or else what all controllers have.

    Without one it asks for a datum or two.
    """
    if description is not UNKNOWN:
        return description
    for described in shipped():
        if described.identity is None:
            continue
        try:
            response = tester.ask(bytes([READ_DATA]) + described.identity.number.to_bytes(2, "big"))
        except PendingError:  # whoever asks next would wait as long
            raise
        except ControllerError:  # it will not tell, or not answer: the question that follows says so
            continue
        if response[3:].rstrip(b"\0 ").decode("latin-1") == described.identity.text:
            return described.description
    return UNKNOWN


ALL_RECORDS: Final = 0xFF
FAILED_MASK: Final = 0xAF  # all bits but those that tell of a test that did not run
FAILED: Final = bytes([READ_TROUBLE, BY_MASK, FAILED_MASK])  # the question for them
START, STOP, RESULTS = 0x01, 0x02, 0x03
ACTIONS: Final = {"start": START, "stop": STOP, "results": RESULTS}


@dataclass(frozen=True, slots=True, kw_only=True)
class DataAnswer:
    """What a controller says of one datum: its bytes and what they mean, or why there are none."""

    number: int
    name: str
    data: bytes = b""
    values: Values | None = None
    refusal: int | None = None
    fault: str = ""  # what is wrong with its answer

    @property
    def refusal_text(self) -> str:
        """Why it will not tell, empty if it does."""
        return "" if self.refusal is None else refusal_text(self.refusal)

    @property
    def trouble(self) -> str:
        """Why there are no values, empty if there are."""
        return self.refusal_text or self.fault


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineAnswer:
    """What a controller says of a routine."""

    number: int
    name: str
    action: str
    data: bytes
    values: Values


def trouble_request(mask: int) -> bytes:
    """Return the request for codes with a status bit of the mask; 0: for all that the controller knows."""
    return bytes([READ_TROUBLE, BY_MASK, mask]) if mask else bytes([READ_TROUBLE, SUPPORTED])


def read_troubles(
    tester: "Dialogue", description: Description, request: bytes = FAILED, *, has_details: bool = True
) -> tuple[TroubleCode, ...]:
    """Return the trouble codes for which a `trouble_request` asks.

    With details each comes with its snapshots and extended data, as far as the controller has them and tells them.
    """
    codes = read_codes(tester.ask(request), description)
    if not has_details:
        return codes
    details = _Details(tester, description)
    return tuple(map(details.added, codes))


_Read = Callable[[bytes, Description], tuple[FailureRecord, ...]]


class _Details:
    """Asks for what was kept of codes; who keeps nothing, or will not tell, is no error, and silence ends one kind."""

    def __init__(self, tester: "Dialogue", description: Description) -> None:
        self._tester, self._description = tester, description
        self._silent: dict[int, str] = {}  # what is not asked any more, and why

    def added(self, code: TroubleCode) -> TroubleCode:
        snapshots, fault = self._told(SNAPSHOTS, code.number, read_snapshots)
        extended, other = self._told(EXTENDED, code.number, read_extended)
        return replace(code, snapshots=snapshots, extended=extended, fault=fault or other)

    def _told(self, kind: int, number: int, read: _Read) -> tuple[tuple[FailureRecord, ...], str]:
        if kind in self._silent:
            return (), self._silent[kind]
        try:
            answer = self._tester.may_ask(
                bytes([READ_TROUBLE, kind]) + number.to_bytes(3, "big") + bytes([ALL_RECORDS])
            )
            return () if isinstance(answer, RefusedError) else read(answer, self._description), ""
        except MalformedAnswerError as exc:
            return (), str(exc)
        except SilentError as exc:
            self._silent[kind] = str(exc)
            return (), str(exc)


def read_datum(tester: "Dialogue", description: Description, number: int) -> DataAnswer:
    """Return what a controller says of a datum; each is asked for by itself, so one refusal costs one."""
    name = description.data_name(number)
    try:
        answer = tester.may_ask(bytes([READ_DATA]) + number.to_bytes(2, "big"))
    except MalformedAnswerError as exc:
        return DataAnswer(number=number, name=name, fault=str(exc))
    if isinstance(answer, RefusedError):
        return DataAnswer(number=number, name=name, refusal=answer.code)
    data = answer[3:]
    if (size := description.size_bytes(number)) not in {None, len(data)}:
        return DataAnswer(
            number=number, name=name, fault=f"its length in bytes is described as {size}, and it came as {shown(data)}"
        )
    return DataAnswer(number=number, name=name, data=data, values=description.values(number, data))


ALL: Final = "all"
GROUPS: Final = {ALL: 0xFFFFFF, "obd": 0xFFFF33}  # ISO 14229-1, annex D.1
_CODE: Final = re.compile(r"([PCBU])([0-3][0-9A-F]{3})(?:-([0-9A-F]{2}))?", re.IGNORECASE)
_NUMBER: Final = re.compile(r"(?:0x)?([0-9A-F]{6})", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class CodeGroup:
    """Which trouble codes are meant: a number of three bytes, or a code with whatever failure type."""

    word: str
    number: int | None  # None: every one of the codes that are there

    def numbers(self, codes: Sequence[TroubleCode]) -> tuple[int, ...]:
        """Return the groups to clear, by the codes that the controller tells.

        Raises ConfigError if there is no such code.
        """
        if self.number is not None:
            return (self.number,)
        found = tuple(code.number for code in codes if code.code == self.word)
        if not found:
            known = ", ".join(dict.fromkeys(code.code for code in codes)) or "none"
            raise ConfigError(f"{self.word} is not among the trouble codes that the controller reports: {known}")
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Clearing:
    """What a controller was told to forget, and what it told before and after."""

    groups: tuple[int, ...]  # empty: somebody said no
    before: tuple[TroubleCode, ...]
    after: tuple[TroubleCode, ...]

    @property
    def gone(self) -> tuple[TroubleCode, ...]:
        left = {code.number for code in self.after}
        return tuple(code for code in self.before if code.number not in left)


def parse_group(text: str, name: str = "--clear") -> CodeGroup:
    """Return what ``all``, ``obd``, ``P0811``, ``P0811-07`` or ``081107`` means; raises ConfigError."""
    if (number := GROUPS.get(text.casefold())) is not None:
        return CodeGroup(word=text.casefold(), number=number)
    if found := _NUMBER.fullmatch(text):
        return CodeGroup(word=found[1].upper(), number=int(found[1], 16))
    if not (found := _CODE.fullmatch(text)):
        raise ConfigError(f"{name} must be all, obd, a code such as P0811 or P0811-07, or three bytes, got {text!r}")
    system, digits, failure_type = found[1].upper(), found[2].upper(), found[3]
    if failure_type is None:
        return CodeGroup(word=system + digits, number=None)
    upper = SYSTEMS.index(system) << 14 | int(digits, 16)
    return CodeGroup(word=text.upper(), number=upper << 8 | int(failure_type, 16))


def clear_request(number: int) -> bytes:
    return bytes([CLEAR]) + number.to_bytes(CODE_BYTES, "big")


EXTENDED_SESSION: Final = 0x03
LARGEST_SESSION: Final = 0x7F
LARGEST_LEVEL: Final = 0x7E
PATIENCE_S: Final = 600.0  # for a routine: it moves parts, and may wait until they are warm
AnswerT_co = TypeVar("AnswerT_co", covariant=True)


class Question(Protocol[AnswerT_co]):
    """What one controller is asked."""

    def requests(self, description: Description) -> list[str]:
        """Return what would be sent, for people, by what is known of the controller; raises ConfigError."""

    def ask(self, tester: "Dialogue", description: Description) -> AnswerT_co:
        """Ask and return the answer; raises ConfigError, and what a `Dialogue` raises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TroubleQuestion:
    """Trouble codes that have a status bit of the mask; 0: all that the controller knows."""

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


def agreed(where: str, codes: Sequence[TroubleCode]) -> bool:
    """Agree to whatever is about to be done: whoever asks has decided before."""
    del where, codes
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class ClearQuestion:
    """Which trouble codes are to be forgotten; those of the mask (0: all) are read before and after."""

    group: CodeGroup
    mask: int = FAILED_MASK
    session: int = DEFAULT_SESSION
    is_agreed: Callable[[str, Sequence[TroubleCode]], bool] = agreed  # by who is asked, and the codes that it tells

    def __post_init__(self) -> None:
        check_number("mask", self.mask, 0xFF)
        check_number("session", self.session, LARGEST_SESSION)

    def requests(self, description: Description) -> list[str]:
        del description
        group, reading = self.group, request_text(trouble_request(self.mask))
        clearing = f"{CLEAR:02X}: {group.word}" if group.number is None else request_text(clear_request(group.number))
        return [f"{reading}: the codes", *_entering(self.session), f"{clearing}: clear", f"{reading}: what is left"]

    def ask(self, tester: "Dialogue", description: Description) -> Clearing:
        """Clear them, unless that is not agreed to, which is asked before the session: that ends if nobody speaks."""
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
    """Data by number in hexadecimal or by name; without any, all that the controller is known to have."""

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
    """A security level, and the mask by which the key follows from the seed: seed XOR mask."""

    level: int  # odd: that of the request for the seed
    mask: bytes

    def __post_init__(self) -> None:
        if not (0 < self.level <= LARGEST_LEVEL and self.level % 2 and self.mask):
            raise ConfigError(f"a security level is odd, 1 to 7D in hexadecimal, and has a mask, got {self.level:X}")


@dataclass(frozen=True, slots=True, kw_only=True)
class RoutineQuestion:
    """What a routine, by number in hexadecimal or by name, is to do: start, stop, or tell its results."""

    routine: str
    action: str
    options: bytes = b""  # what it is started with
    session: int = EXTENDED_SESSION
    lock: Lock | None = None  # what is unlocked before
    patience_s: float = PATIENCE_S  # how long it may say that it takes longer

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
        """Ask, in the session that is wanted, and unlocked if need be."""
        number = description.find_routine(self.routine)
        with tester.patience(self.patience_s), tester.session(self.session):
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
                raise MalformedAnswerError(f"{text}, and they came as {shown(data) or 'nothing'}")
            fields = ()  # an answer to a start may hold the results, or something else
        name = "" if routine is None else routine.name
        return RoutineAnswer(number=number, name=name, action=self.action, data=data, values=read_fields(fields, data))


def _entering(session: int) -> Iterable[str]:
    return () if session == DEFAULT_SESSION else (request_text(bytes([SESSION, session])),)
