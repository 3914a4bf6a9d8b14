"""Trouble codes that a controller is told to forget (service 14), and what it still tells afterwards."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from diag_service.errors import ConfigError
from diag_service.tester.answers import CLEAR
from diag_service.tester.description import SYSTEMS, Description
from diag_service.tester.reading import read_troubles, trouble_request
from diag_service.tester.trouble import CODE_BYTES, TroubleCode

if TYPE_CHECKING:
    from diag_service.tester.dialogue import Dialogue

ALL: Final = "all"
GROUPS: Final = {ALL: 0xFFFFFF, "obd": 0xFFFF33}  # ISO 14229-1, annex D.1
_CODE: Final = re.compile(r"([PCBU])([0-3][0-9A-F]{3})(?:-([0-9A-F]{2}))?", re.IGNORECASE)
_NUMBER: Final = re.compile(r"(?:0x)?([0-9A-F]{6})", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Which trouble codes are meant: a number of three bytes, or a code with whatever failure type."""

    word: str
    number: int | None  # None: every one of the codes that are there

    def numbers(self, codes: Sequence[TroubleCode]) -> tuple[int, ...]:
        """Return the groups to clear, by the codes that the controller tells.

        Raises
        ------
        ConfigError
            If there is no such code.
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
        """The codes that it does not tell any more."""
        left = {code.number for code in self.after}
        return tuple(code for code in self.before if code.number not in left)


def parse_group(text: str, name: str = "--clear") -> Group:
    """Return what ``all``, ``obd``, ``P0811``, ``P0811-07`` or ``081107`` means; raises ConfigError."""
    if (number := GROUPS.get(text.casefold())) is not None:
        return Group(word=text.casefold(), number=number)
    if found := _NUMBER.fullmatch(text):
        return Group(word=found[1].upper(), number=int(found[1], 16))
    if not (found := _CODE.fullmatch(text)):
        raise ConfigError(f"{name} must be all, obd, a code such as P0811 or P0811-07, or three bytes, got {text!r}")
    system, digits, failure_type = found[1].upper(), found[2].upper(), found[3]
    if failure_type is None:
        return Group(word=system + digits, number=None)
    upper = SYSTEMS.index(system) << 14 | int(digits, 16)
    return Group(word=text.upper(), number=upper << 8 | int(failure_type, 16))


def clear_request(number: int) -> bytes:
    """Return the request to forget a group."""
    return bytes([CLEAR]) + number.to_bytes(CODE_BYTES, "big")


def clear_troubles(
    tester: "Dialogue",
    description: Description,
    group: Group,
    *,
    mask: int,
    session: int,
    is_agreed: Callable[[Sequence[TroubleCode]], bool],
) -> Clearing:
    """Read the trouble codes, clear a group of them, and read what is left.

    Parameters
    ----------
    mask
        Of the codes that are read; 0 is for all.
    session
        In which they are cleared.
    is_agreed
        Whether these codes may be cleared; asked before the session is entered, which ends if nobody speaks.

    Raises
    ------
    ConfigError
        If the code is not there.
    RefusedError, SilentError, ControllerError
        As a `Dialogue` does.
    """
    before = read_troubles(tester, description, trouble_request(mask), has_details=False)
    groups = group.numbers(before)
    if not is_agreed(before):
        return Clearing(groups=(), before=before, after=before)
    with tester.session(session):
        for number in groups:
            tester.ask(clear_request(number))
    after = read_troubles(tester, description, trouble_request(mask), has_details=False)
    return Clearing(groups=groups, before=before, after=after)
