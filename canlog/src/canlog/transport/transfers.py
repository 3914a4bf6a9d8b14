"""What transport protocols give: whole messages, and why the others are not whole."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

NS_PER_MS: Final = 1_000_000
MOST_OPEN: Final = 1_024  # transfers of one protocol at a time: every pair of J1939 addresses on a busy bus, and noise


class Protocol(StrEnum):
    """How a message is cut into frames."""

    ISO_TP = "iso_tp"  # ISO 15765-2
    J1939_TP = "j1939_tp"  # SAE J1939-21, BAM and RTS/CTS


class Fault(StrEnum):
    """Why a message was not put together."""

    FRAME_MISSING = "frame_missing"  # the next frame was not the one that had to come
    NO_BEGINNING = "no_beginning"  # frames of a message whose first one is not in the log
    TIMEOUT = "timeout"  # nothing followed for longer than the standard allows
    INTERRUPTED = "interrupted"  # another message began, or a request came, before it was complete
    ABORTED = "aborted"  # one of the two sides gave up
    WRONG_LENGTH = "wrong_length"  # the first frame states a length that no message of its kind has
    CUT_OFF = "cut_off"  # the log ends inside it
    TOO_MANY = "too_many"  # so many at a time that the oldest was given up


def is_padding(data: bytes | bytearray) -> bool:
    """Return whether bytes behind a message say nothing: 0xFF, as the standards have it, or 0, as some devices do."""
    return not data.strip(b"\xff\0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """A whole message; ``destination`` is an address of J1939, -1 where the protocol has none."""

    protocol: Protocol
    channel: int
    can_id: (
        int  # of the sender's frames, with flags; of J1939 with the group of the message in place of the transport's
    )
    destination: int = -1
    first_ns: int  # when its first frame came
    last_ns: int  # when it was complete
    frames: int
    data: bytes


@dataclass(slots=True)
class TransferCounts:
    """What became of messages: those that are whole, and the others by why they are not."""

    whole: dict[Protocol, int] = field(default_factory=dict)
    incomplete: dict[tuple[Protocol, Fault], int] = field(default_factory=dict)

    def add_whole(self, protocol: Protocol) -> None:
        self.whole[protocol] = self.whole.get(protocol, 0) + 1

    def add_fault(self, protocol: Protocol, fault: Fault) -> None:
        """Count one that is not whole."""
        self.incomplete[protocol, fault] = self.incomplete.get((protocol, fault), 0) + 1

    @property
    def incomplete_count(self) -> int:
        """How many are not whole."""
        return sum(self.incomplete.values())

    def in_words(self) -> list[str]:
        """Return the counts for people, a line for each protocol that occurred."""
        lines = []
        for protocol in Protocol:
            faults = {fault: count for (one, fault), count in self.incomplete.items() if one is protocol}
            if not faults and protocol not in self.whole:
                continue
            reasons = ", ".join(f"{count} {fault.value.replace('_', ' ')}" for fault, count in sorted(faults.items()))
            name = protocol.value.replace("_", " ")
            what = f"{self.whole.get(protocol, 0)} whole messages, {sum(faults.values())} incomplete"
            lines.append(f"{name}: {what}{f' ({reasons})' if reasons else ''}")
        return lines
