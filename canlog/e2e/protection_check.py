"""Which frames may be believed: length, then CRC, then alive counter, as AUTOSAR E2E profile 1 orders them.

A message is followed from one origin: the channel and, with J1939, the source address that the profile names, else
those of its first sound frame. Frames of the same message from elsewhere are counted and never mixed in.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np
from cantools.database.can import Message

from canlog.arrays import Int64Array
from canlog.database.addressing import ANY, Address, address_book, message_address
from canlog.e2e.alive_counter import MAX_FRAMES_LOST_BY_RESTART, forget, fresh_links
from canlog.e2e.contract import message_contract
from canlog.e2e.frame_judge import (
    ORIGINS,
    FrameColumns,
    FrameReason,
    FrameVerdicts,
    Origins,
    Rules,
    Totals,
    judge_frames,
)
from canlog.e2e.profile1 import data_id_remainder
from canlog.errors import DefinitionError
from canlog.frames import FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch, empty_batch

__all__ = ["MAX_FRAMES_LOST_BY_RESTART", "FrameReason", "FrameVerdicts", "LinkMonitor"]

_NS_PER_MS: Final = 1_000_000


class LinkMonitor:
    """Judges the frames of the messages that are looked at; verdicts do not depend on how the stream was cut.

    Messages whose database names no data id are checked for their length only.

    Parameters
    ----------
    messages : sequence of Message
        The messages that are looked at.
    addresses : sequence of Address, optional
        How the frames of each are known; left out: as the database says.

    Raises
    ------
    DefinitionError
        If two messages share an identifier, or a protected one does not have 8 bytes.
    """

    def __init__(self, messages: Sequence[Message], addresses: Sequence[Address] | None = None) -> None:
        if addresses is None:
            addresses = [message_address(message) for message in messages]
        self._book = address_book(addresses)
        self._rules = _rules_of(messages)
        self._links = fresh_links(len(messages))
        self._origins = Origins(
            channel=np.full(len(messages), ANY, np.int64),
            named=np.array([address.channel for address in addresses], np.int64),
            number=np.arange(ORIGINS, dtype=np.int64),
            sender=np.array([address.sender for address in addresses], np.int64),
            channel_frames=np.zeros((len(messages), ORIGINS), np.int64),
            sender_frames=np.zeros((len(messages), ORIGINS), np.int64),
        )
        self._totals = Totals(
            frames=np.zeros((len(messages) + 1, len(FrameReason)), np.int64),
            missing=np.zeros(len(messages), np.int64),
            marked=np.zeros((ORIGINS, len(FrameReason)), np.int64),
        )
        self.check(empty_batch())  # compiles now: the first real batch must not wait for the compiler

    @property
    def counts(self) -> Int64Array:
        """Frames by message and reason, shape (m + 1, reasons); the last row counts frames of no message."""
        return self._totals.frames.copy()

    @property
    def missing(self) -> Int64Array:
        """Frames that the counter shows were sent but never came, by message, shape (m,)."""
        return self._totals.missing.copy()

    def senders(self, slot: int) -> Mapping[int, int]:
        """Return how many frames of a J1939 message each source address sent, on the channel that counts."""
        return _nonzero(self._origins.sender_frames[slot])

    def channels(self, slot: int) -> Mapping[int, int]:
        """Return how many frames of a message came on each channel."""
        return _nonzero(self._origins.channel_frames[slot])

    def begin_source(self, source: int, channel: int) -> None:
        """Learn that frames marked with ``source`` come from a channel of some log; at first a mark is the channel."""
        self._origins.number[source] = channel

    def source_counts(self, source: int) -> Mapping[FrameReason, int]:
        """Return what became of the frames with a mark since it was given; reasons that occurred."""
        return MappingProxyType({FrameReason(place): n for place, n in _nonzero(self._totals.marked[source]).items()})

    def end_source(self, source: int) -> None:
        """Follow its messages from where they are heard next: a log has ended, and its mark may be given to another."""
        self._origins.channel[self._origins.channel == source] = ANY
        self._totals.marked[source] = 0

    def reset(self) -> None:
        """Forget counters and times, after a jump of bus time; counts, sequence numbers and origins go on."""
        forget(self._links)

    def check(self, batch: FrameBatch) -> FrameVerdicts:
        """Return a verdict on each frame of a plain batch and count it."""
        count = len(batch)
        verdicts = FrameVerdicts(
            reason=np.empty(count, np.uint8),
            slot=np.empty(count, np.int64),
            sequence=np.empty(count, np.int64),
            missing=np.empty(count, np.int64),
        )
        frames = FrameColumns(batch.t_ns, batch.can_id, batch.length, batch.data, batch.channel)
        judge_frames(self._book, self._rules, self._links, self._origins, frames, verdicts, self._totals)
        return verdicts


def _rules_of(messages: Sequence[Message]) -> Rules:
    """Return what the database demands of its messages."""
    contracts = [message_contract(message) for message in messages]
    for message, contract in zip(messages, contracts, strict=True):
        if contract.data_id is not None and message.length != PAYLOAD_BYTES:
            raise DefinitionError(
                f"{message.name}: protection is understood for messages of {PAYLOAD_BYTES} bytes only"
            )
    return Rules(
        min_length=np.array([min(message.length, FD_PAYLOAD_BYTES) for message in messages], np.int64),
        is_protected=np.array([contract.data_id is not None for contract in contracts], np.int64),
        id_remainder=np.array([data_id_remainder(contract.data_id or 0) for contract in contracts], np.uint8),
        cycle_ns=np.array([contract.cycle_ms * _NS_PER_MS for contract in contracts], np.int64),
    )


def _nonzero(counts: Int64Array) -> Mapping[int, int]:
    """Return the counts that are not zero, by their place."""
    return MappingProxyType({int(place): int(counts[place]) for place in np.flatnonzero(counts)})
