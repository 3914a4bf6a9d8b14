"""Thousands of messages a second on a connection that paho-mqtt has made: read and acknowledged in large pieces.

A client library reads a packet by several calls of the system and acknowledges each by one more, which takes longer
than to look at a result. So whoever takes messages, and settles them later, goes on alone with the socket once it has
subscribed, in MQTT 5: messages in, their acknowledgements out, messages out, and a sign of life.
"""

import logging
import ssl
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from fleet_contract import Outgoing

_LOG: Final = logging.getLogger(__name__)
_PIECE_BYTES: Final = 1 << 18
_PUBLISH, _PUBACK, _PINGRESP = 3, 4, 13
_PUBLISH_AT_LEAST_ONCE, _RETAINED, _ACKNOWLEDGE = 0x32, 0x01, b"\x40\x02"
_PING: Final = b"\xc0\x00"
_FAILURE: Final = 0x80  # the least reason that says no: MQTT 5.0, 2.4
_MOST_IDENTIFIERS: Final = 65_535
_LENGTH_BYTES: Final = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class BulkTerms:
    """What was agreed upon with the broker."""

    keepalive_s: float
    max_packet_bytes: int
    max_in_flight: int  # messages of ours without an answer


class Socket(Protocol):
    """What is needed of a socket, with TLS or without."""

    def recv(self, count: int, /) -> bytes:
        """Return what has come, or raise BlockingIOError or one of SSL's."""

    def send(self, data: bytearray, /) -> int:
        """Send a beginning of data; return how long it was."""


class Bulk:
    """Packets of a connection, from the moment it has subscribed.

    Parameters
    ----------
    take : callable
        Called with topic, payload and packet identifier of each message; the identifier is 0 if none is to be settled.
    now_s : callable
        Returns a time that never jumps [s].
    """

    def __init__(
        self, sock: Socket, terms: BulkTerms, take: Callable[[str, bytes, int], None], now_s: Callable[[], float]
    ) -> None:
        self._socket = sock
        self._terms = terms
        self._take = take
        self._now_s = now_s
        self._in = bytearray()
        self._out = bytearray()
        self._waiting: deque[Outgoing] = deque()
        self._in_flight: dict[int, str] = {}  # topics by packet identifier
        self._identifier = 0
        self._heard_s = self._asked_s = now_s()

    @property
    def has_more(self) -> bool:
        """Whether something waits until the socket takes it."""
        return bool(self._out)

    def read(self) -> None:
        """Take what has come; raises OSError, or ValueError for what is no MQTT, when the connection is at its end."""
        while True:
            try:
                data = self._socket.recv(_PIECE_BYTES)
            except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
                break
            if not data:
                raise ConnectionError("connection lost")
            self._in += data
            if len(data) < _PIECE_BYTES and not (isinstance(self._socket, ssl.SSLSocket) and self._socket.pending()):
                break
        self._heard_s = self._now_s()
        self._look()

    def acknowledge(self, identifiers: Iterable[int]) -> None:
        """Tell the broker that messages have arrived for good."""
        self._out += b"".join(_ACKNOWLEDGE + identifier.to_bytes(2) for identifier in identifiers)

    def send(self, messages: Iterable[Outgoing]) -> None:
        """Send messages at least once, as many at a time as the broker wants."""
        self._waiting.extend(messages)
        while self._waiting and len(self._in_flight) < self._terms.max_in_flight:
            message = self._waiting.popleft()
            identifier = self._next_identifier()
            self._in_flight[identifier] = message.topic
            topic = message.topic.encode()
            body = len(topic).to_bytes(2) + topic + identifier.to_bytes(2) + b"\x00" + message.payload
            self._out.append(_PUBLISH_AT_LEAST_ONCE | (_RETAINED if message.is_retained else 0))
            self._out += _length(len(body)) + body

    def flush(self) -> None:
        """Write what waits, as far as the socket takes it; raises OSError when the connection is at its end."""
        while self._out:
            try:
                count = self._socket.send(self._out)
            except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
                return
            del self._out[:count]

    def tick(self) -> None:
        """Give a sign of life now and then; raises ConnectionError if the broker gives none."""
        now_s, keepalive_s = self._now_s(), self._terms.keepalive_s
        if now_s - self._heard_s > 1.5 * keepalive_s:
            raise ConnectionError("the broker says nothing")
        if now_s - self._asked_s > 0.5 * keepalive_s:
            self._asked_s = now_s
            self._out += _PING

    def _next_identifier(self) -> int:
        while True:
            self._identifier = self._identifier % _MOST_IDENTIFIERS + 1
            if self._identifier not in self._in_flight:
                return self._identifier

    def _look(self) -> None:
        """Take the packets that are complete."""
        data, at = bytes(self._in), 0
        while (found := self._packet(data, at)) is not None:
            start, end = found
            self._packet_came(data[at], data[start:end])
            at = end
        del self._in[:at]

    def _packet(self, data: bytes, at: int) -> tuple[int, int] | None:
        """Return where the content of the packet at a place starts and ends, or None if it is not all there."""
        length, place = 0, at + 1
        while place < len(data):
            length |= (data[place] & 0x7F) << 7 * (place - at - 1)
            place += 1
            if not data[place - 1] & 0x80:
                if length > self._terms.max_packet_bytes:
                    raise ValueError(f"a packet of {length} bytes")
                return (place, place + length) if place + length <= len(data) else None
            if place - at > _LENGTH_BYTES:
                raise ValueError("a length of more than four bytes")
        return None

    def _packet_came(self, first: int, body: bytes) -> None:
        kind = first >> 4
        if kind == _PUBLISH:
            self._message_came(first, body)
        elif kind == _PUBACK:
            topic = self._in_flight.pop(int.from_bytes(body[:2]), None)
            if topic is not None and body[2:3] >= bytes([_FAILURE]):
                _LOG.warning("the broker refused an acknowledgement: reason %d, %s", body[2], topic)
            self.send(())
        elif kind != _PINGRESP:
            raise ValueError(f"a packet of kind {kind}")

    def _message_came(self, first: int, body: bytes) -> None:
        at = 2 + int.from_bytes(body[:2])
        topic = body[2:at].decode()
        identifier = 0
        if first & 0x06:
            identifier = int.from_bytes(body[at : at + 2])
            at += 2
        length, shift = 0, 0
        while True:  # of its properties, which we need not know
            digit = body[at]
            at += 1
            length |= (digit & 0x7F) << shift
            shift += 7
            if not digit & 0x80:
                break
        if at + length > len(body):
            raise ValueError("a message that ends before its properties")
        self._take(topic, body[at + length :], identifier)


def _length(number: int) -> bytes:
    """Return a length, seven bits a byte."""
    data = bytearray()
    while True:
        number, digit = divmod(number, 128)
        data.append(digit | (0x80 if number else 0))
        if not number:
            return bytes(data)
