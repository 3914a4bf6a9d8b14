"""What one controller is asked, as values: what would be sent, and what it answers."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from diag_service.errors import ConfigError
from diag_service.tester.answers import CLEAR, READ_DATA, ROUTINE, SECURITY, SESSION, request_text
from diag_service.tester.clearing import Clearing, Group, clear_request, clear_troubles
from diag_service.tester.description import UNKNOWN, Description
from diag_service.tester.reading import (
    ACTIONS,
    FAILED_MASK,
    DataAnswer,
    RoutineAnswer,
    control_routine,
    read_data,
    read_troubles,
    trouble_request,
)
from diag_service.tester.timing import DEFAULT_SESSION
from diag_service.tester.trouble import TroubleCode

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue

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
    group: int | None = None  # a readiness group, in place of the mask
    record: int | None = None  # of extended data: codes that have it, in place of the mask

    def __post_init__(self) -> None:
        check_number("mask", self.mask, 0xFF)
        if self.group is not None and self.record is not None:
            raise ConfigError("ask for a readiness group or for a record, not for both")

    def requests(self, description: Description) -> list[str]:
        """Return what would be sent."""
        del description
        details = ["19 04 and 19 06: what was kept of each code"] if self.has_details else []
        return [f"{request_text(self._request)}: the codes", *details]

    def ask(self, tester: "Dialogue", description: Description) -> tuple[TroubleCode, ...]:
        return read_troubles(tester, description, self._request, has_details=self.has_details)

    @property
    def _request(self) -> bytes:
        return trouble_request(self.mask, group=self.group, record=self.record)


def agreed(where: str, codes: Sequence[TroubleCode]) -> bool:
    """Agree to whatever is about to be done: whoever asks has decided before."""
    del where, codes
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class ClearQuestion:
    """Which trouble codes are to be forgotten; those of the mask (0: all) are read before and after."""

    group: Group
    mask: int = FAILED_MASK
    session: int = DEFAULT_SESSION
    is_agreed: Callable[[str, Sequence[TroubleCode]], bool] = agreed  # by who is asked, and the codes that it tells

    def __post_init__(self) -> None:
        check_number("mask", self.mask, 0xFF)
        check_number("session", self.session, LARGEST_SESSION)

    def requests(self, description: Description) -> list[str]:
        """Return what would be sent."""
        del description
        group, reading = self.group, request_text(trouble_request(self.mask))
        clearing = f"{CLEAR:02X}: {group.word}" if group.number is None else request_text(clear_request(group.number))
        return [f"{reading}: the codes", *_entering(self.session), f"{clearing}: clear", f"{reading}: what is left"]

    def ask(self, tester: "Dialogue", description: Description) -> Clearing:
        """Clear them, unless that is not agreed to."""
        return clear_troubles(
            tester, description, self.group, mask=self.mask, session=self.session,
            is_agreed=lambda codes: self.is_agreed(tester.where, codes),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class DataQuestion:
    """Data by number in hexadecimal or by name; without any, all that the controller is known to have."""

    words: tuple[str, ...] = ()
    session: int = DEFAULT_SESSION

    def __post_init__(self) -> None:
        check_number("session", self.session, LARGEST_SESSION)

    def requests(self, description: Description) -> list[str]:
        """Return what would be sent."""
        if self.words and description is UNKNOWN:
            return [*_entering(self.session), *(f"22: {word}" for word in self.words)]
        questions = (bytes([READ_DATA]) + number.to_bytes(2, "big") for number in self._numbers(description))
        return [*_entering(self.session), *map(request_text, questions)]

    def ask(self, tester: "Dialogue", description: Description) -> tuple[DataAnswer, ...]:
        """Ask, in the session that is wanted."""
        with tester.session(self.session):
            return tuple(read_data(tester, description, self._numbers(description)))

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
        """Return what would be sent."""
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
            return control_routine(tester, description, number, self.action, self.options)


def check_number(name: str, value: int, most: int) -> None:
    """Raise ConfigError unless a number is 0 to ``most``."""
    if not 0 <= value <= most:
        raise ConfigError(f"{name} must be 0 to {most:X} in hexadecimal, got {value:X}")


def _entering(session: int) -> Iterable[str]:
    return () if session == DEFAULT_SESSION else (request_text(bytes([SESSION, session])),)
