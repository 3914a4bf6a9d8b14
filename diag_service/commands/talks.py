"""What ``inspect`` and ``monitor`` ask of the tester's annex: conversations in the frames of a log or a bus."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final, Protocol

from cantools.database.can import Message

from canlog.frames import EXTENDED_FLAG, FrameBatch
from clutchdiag_io.program import part
from diag_service.errors import ConfigError
from fleet_contract import JsonObject

STANDARD_DIGITS: Final = 3
HIGHEST_STANDARD: Final = 0x7FF
HIGHEST_EXTENDED: Final = 0x1FFF_FFFF


class Conversations(Protocol):
    """Messages longer than a frame, and what testers asked and controllers answered."""

    def show_at_once(self, show: Callable[[str], object]) -> None:
        """Have what is settled shown when it is, from now on: the frames come from a bus that goes on."""

    def add(self, batch: FrameBatch) -> None:
        """Take the frames that follow: at least one."""

    def close(self) -> None:
        """End."""

    def news(self, now_ns: int) -> Iterator[str]:
        """Yield for people what is settled at a time on the bus; it is not kept any longer."""

    def lines(self) -> Iterator[str]:
        """Yield all of it for people that has not been told as news."""

    def record(self) -> JsonObject:
        """Return all of it for programs."""


def conversations_of(messages: Sequence[Message], pairs: str) -> Conversations:
    """Return what puts conversations together; raises ConfigError if the pairs of identifiers are none."""
    talks: Conversations = part("diag_service.parts", "conversations")(messages, pairs)
    return talks


def pairs_of(text: str) -> tuple[tuple[int, int], ...]:
    """Return ``79B:7BB,18DA10F1:18DAF110`` as identifiers with flags; raises ConfigError."""
    found = []
    for pair in filter(None, (one.strip() for one in text.split(","))):
        request, _, answer = pair.partition(":")
        try:
            found.append((_flagged(request), _flagged(answer)))
        except ValueError:
            raise ConfigError(f"--pairs {pair!r}: say REQUEST:ANSWER in hexadecimal, as in 79B:7BB") from None
    return tuple(found)


def _flagged(text: str) -> int:
    """Return an identifier with its flags; more than three digits make it an extended one."""
    value, is_extended = int(text, 16), len(text.strip().removeprefix("0x")) > STANDARD_DIGITS
    if not 0 <= value <= (HIGHEST_EXTENDED if is_extended else HIGHEST_STANDARD):
        raise ValueError(text)
    return value | EXTENDED_FLAG if is_extended else value
