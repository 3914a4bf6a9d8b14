"""A load of results that costs next to nothing: MQTT packets made beforehand, sent in large pieces over bare sockets.

A client library would take more of the two cores than the worker under test. What was not acknowledged by the backend
stays below a window, as an edge's outbox keeps it.
"""

import json
import random
import socket
import threading
import time
from bisect import bisect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

_KEEPALIVE_S: Final = 600
_CONNECT_REQUEST, _PUBLISH_QOS1, _SUBSCRIBE = 0x10, 0x32, 0x82
_PUBLISH_TYPE, _PUBACK = 3, 0x40
_PIECE: Final = 200  # results per send
_AT_ANY_TIME: Final = 0.4  # of the messages of a day
_RUSH_HOURS: Final = (7.5, 17.0)
_PACE_S: Final = 0.01  # between pieces at a steady pace
_READ_BYTES: Final = 1 << 18


@dataclass(frozen=True, slots=True, kw_only=True)
class Wire:
    """A message as MQTT 3.1.1 carries it, but for its packet identifier."""

    head: bytes
    payload: bytes
    keys: Sequence[tuple[str, int]] = ()  # vehicle and position of each result in it, where that matters

    @property
    def count(self) -> int:
        """How many results it carries."""
        return len(self.keys) or 1

    def packet(self, number: int) -> bytes:
        """Return the PUBLISH packet, QoS 1."""
        return self.head + (number % 65_535 + 1).to_bytes(2) + self.payload


def wire(topic: str, payload: bytes, keys: Sequence[tuple[str, int]] = ()) -> Wire:
    """Return the packet of a message."""
    name = _text(topic)
    head = bytes([_PUBLISH_QOS1]) + _length(len(name) + 2 + len(payload)) + name
    return Wire(head=head, payload=payload, keys=keys)


def result_count(messages: Sequence[Wire]) -> int:
    """Return how many results messages carry."""
    return sum(message.count for message in messages)


def steady_s(count: int, per_s: float) -> list[float]:
    """Return when messages are due at a steady pace, since the beginning [s]."""
    return [number / per_s for number in range(count)]


def rush_s(count: int, per_s: float, rng: random.Random) -> list[float]:
    """Return when messages are due on a day with two rush hours, put into as long as a steady pace takes [s].

    Two fifths come at any time; the rest around half past seven and five o'clock, when about three times as many
    come as on average.
    """
    day = [
        rng.uniform(0.0, 24.0) if rng.random() < _AT_ANY_TIME else rng.gauss(rng.choice(_RUSH_HOURS), 1.0) % 24.0
        for _ in range(count)
    ]
    return sorted(hour / 24.0 * count / per_s for hour in day)


class Load:
    """A publisher that counts the acknowledgements of the backend for a set of vehicles.

    It publishes on as many connections as are wanted, in turns: a broker may look at those of one connection one after
    the other, and vehicles are many.
    """

    def __init__(self, port: int, name: str, ack_topics: Sequence[str], connections: int = 1) -> None:
        self._socket = _connected(port, name)
        self._others = [_connected(port, f"{name}-{number}") for number in range(1, connections)]
        self._next = 0
        self.acknowledged_count = 0
        self.heard_s: dict[tuple[str, int], float] = {}  # when the word on a result came, while `is_timed`
        self.is_timed = False
        self._changed = threading.Condition()
        self._turn = threading.Lock()  # a large piece must not be torn by the reader's acknowledgements
        for other in self._others:
            threading.Thread(target=_drain, args=(other,), daemon=True).start()
        if ack_topics:
            self._subscribe(ack_topics)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def send(self, messages: Sequence[Wire], window: int, timeout_s: float) -> float:
        """Send all messages and wait for the backend's word on each; return how long it took [s]."""
        began_s, first, sent_count = time.perf_counter(), 0, 0
        while first < len(messages):
            piece = messages[first : first + max(1, _PIECE // messages[first].count)]
            sent_count += result_count(piece)
            self._wait(sent_count - window, began_s + timeout_s)
            self._publish(b"".join(message.packet(first + place) for place, message in enumerate(piece)))
            first += len(piece)
        self._wait(sent_count, began_s + timeout_s)
        return time.perf_counter() - began_s

    def pace(self, messages: Sequence[Wire], after_s: Sequence[float], timeout_s: float) -> list[float]:
        """Send messages so long after the beginning and wait for the word on each; return when each was due [s]."""
        began_s, first = time.perf_counter(), 0
        while first < len(messages):
            time.sleep(max(0.0, began_s + after_s[first] - time.perf_counter()))
            due = bisect(after_s, time.perf_counter() - began_s + _PACE_S, first + 1)
            piece = messages[first:due]
            self._publish(b"".join(message.packet(first + place) for place, message in enumerate(piece)))
            first = due
        self._wait(result_count(messages), time.perf_counter() + timeout_s)
        return [began_s + one_s for one_s in after_s]

    def pour(self, messages: Sequence[Wire]) -> None:
        """Send messages and wait for nobody."""
        for first in range(0, len(messages), _PIECE):
            piece = messages[first : first + _PIECE]
            self._publish(b"".join(message.packet(first + place) for place, message in enumerate(piece)))

    def close(self) -> None:
        """Leave the broker."""
        self._socket.shutdown(socket.SHUT_RDWR)
        self._reader.join()
        self._socket.close()
        for other in self._others:
            other.shutdown(socket.SHUT_RDWR)

    def _publish(self, data: bytes) -> None:
        """Send on the next connection."""
        self._next = (self._next + 1) % (1 + len(self._others))
        if self._next:
            self._others[self._next - 1].sendall(data)
        else:
            self._send(data)

    def _send(self, data: bytes) -> None:
        with self._turn:
            self._socket.sendall(data)

    def _wait(self, count: int, deadline_s: float) -> None:
        with self._changed:
            left_s = deadline_s - time.perf_counter()
            if not self._changed.wait_for(lambda: self.acknowledged_count >= count, left_s):
                raise TimeoutError(f"{self.acknowledged_count} acknowledged, {count} expected")

    def _subscribe(self, topics: Sequence[str]) -> None:
        self._send(subscribe_packet(topics))

    def _read(self) -> None:
        for first_byte, body in _packets(self._socket):
            if first_byte >> 4 != _PUBLISH_TYPE:
                continue
            topic_length = int.from_bytes(body[:2])
            at = 2 + topic_length
            if first_byte & 0x06:
                self._send(bytes([_PUBACK, 2]) + body[at : at + 2])
                at += 2
            told = json.loads(body[at:])["data"]
            if self.is_timed:
                now_s = time.perf_counter()
                self.heard_s.update({(told["vehicle"], one["seq"]): now_s for one in told["results"]})
            with self._changed:
                self.acknowledged_count += len(told["results"])
                self._changed.notify_all()


def _connected(port: int, name: str) -> socket.socket:
    made = socket.create_connection(("127.0.0.1", port))
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    made.sendall(connect_packet(name))
    return made


def _drain(source: socket.socket) -> None:
    """Read what a broker answers, until the connection is closed."""
    with source:
        for _ in _packets(source):
            pass


def _packets(source: socket.socket) -> Iterator[tuple[int, bytes]]:
    """Yield first byte and body of each packet, until the socket is closed."""
    buffer = bytearray()
    while True:
        try:
            data = source.recv(_READ_BYTES)
        except OSError:
            return
        if not data:
            return
        buffer += data
        yield from packets_in(buffer)


def packets_in(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Yield first byte and body of each packet in a buffer, and take it out."""
    while (end := _packet_end(buffer)) is not None:
        start, stop = end
        yield buffer[0], bytes(buffer[start:stop])
        del buffer[:stop]


def _packet_end(buffer: bytearray) -> tuple[int, int] | None:
    """Return where the body of the first packet starts and stops, if all of it is there."""
    length, shift = 0, 0
    for place in range(1, min(len(buffer), 5)):
        length |= (buffer[place] & 0x7F) << shift
        shift += 7
        if not buffer[place] & 0x80:
            stop = place + 1 + length
            return (place + 1, stop) if stop <= len(buffer) else None
    return None


def subscribe_packet(topics: Sequence[str]) -> bytes:
    """Return the packet that subscribes to topics, QoS 1."""
    body = (1).to_bytes(2) + b"".join(_text(topic) + b"\x01" for topic in topics)
    return bytes([_SUBSCRIBE]) + _length(len(body)) + body


def connect_packet(name: str) -> bytes:
    body = _text("MQTT") + b"\x04\x02" + _KEEPALIVE_S.to_bytes(2) + _text(name)
    return bytes([_CONNECT_REQUEST]) + _length(len(body)) + body


def _text(text: str) -> bytes:
    data = text.encode()
    return len(data).to_bytes(2) + data


def _length(number: int) -> bytes:
    """Return a remaining length, seven bits a byte."""
    data = bytearray()
    while True:
        number, digit = divmod(number, 128)
        data.append(digit | (0x80 if number else 0))
        if not number:
            return bytes(data)
