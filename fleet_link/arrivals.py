"""What a broker delivered and nobody has taken yet; a batch ends by its count or by its bytes."""

import math
from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """What a broker delivered."""

    topic: str
    payload: bytes
    packet_id: int  # for its acknowledgement to the broker; 0 needs none
    is_retained: bool = False  # kept by the broker from before we asked for it


class Arrivals:
    """Messages that wait to be taken, and how many bytes they hold.

    Parameters
    ----------
    max_bytes :
        Of two batches; None: only their count matters.
    """

    def __init__(self, max_bytes: int | None) -> None:
        self._messages: deque[Message] = deque()
        self._bytes = 0
        self._batch_bytes = math.inf if max_bytes is None else max_bytes / 2

    def __len__(self) -> int:
        return len(self._messages)

    def append(self, message: Message) -> None:
        self._messages.append(message)
        self._bytes += len(message.payload)

    def has_batch(self, limit: int) -> bool:
        """Return whether as many wait as a batch may have."""
        return len(self._messages) >= limit or self._bytes >= self._batch_bytes

    def take(self, limit: int) -> list[Message]:
        """Return the next messages, as many as a batch may have."""
        found: list[Message] = []
        size = 0
        while self._messages and len(found) < limit and size < self._batch_bytes:
            found.append(self._messages.popleft())
            size += len(found[-1].payload)
        self._bytes -= size
        return found
