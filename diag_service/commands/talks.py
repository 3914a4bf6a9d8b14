"""What ``inspect`` and ``monitor`` ask of the tester's annex: conversations in the frames of a log or a bus."""

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from cantools.database.can import Message

from canlog.frames import FrameBatch
from clutchdiag_io.annexes import part
from fleet_contract import JsonObject


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
