"""What is taken of the packets that a broker delivers: bounded before anything of them is parsed.

Any vehicle may send a message with properties, of which paho-mqtt unpacks 50,000 in 4.5 s, and nobody here reads any.
"""

from dataclasses import dataclass
from typing import Any, Final

from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTErrorCode, MQTTProtocolVersion

from fleet_link.address import LinkError

MOST_PROPERTY_BYTES: Final = 1_024  # of a message: far above a correlation or a trace
MOST_ANSWER_BYTES: Final = 4_096  # of the broker's own packets, which have a reason in words at most
_PUBLISH: Final = 0x30
_KIND: Final = 0xF0  # the bits of a packet's first byte that hold its kind
_QOS: Final = 0x06
_HEAD_BYTES: Final = 2 + 65_535 + 2 + 4  # before properties and payload: the longest topic, packet id, a length


class PacketError(LinkError):
    """A broker sends what is no packet, or an answer that is too long: the connection is at its end."""


def excess_of(property_bytes: int) -> str | None:
    """Return what is too long about the properties of a message; None: nothing."""
    if property_bytes <= MOST_PROPERTY_BYTES:
        return None
    return f"{property_bytes} bytes of properties, more than {MOST_PROPERTY_BYTES}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishParts:
    """What a PUBLISH holds; its content is everything behind the fixed header."""

    head_end: int  # of topic and packet id
    property_bytes: int
    payload_start: int


def read_publish(first: int, content: bytes | bytearray, *, is_version_5: bool) -> PublishParts:
    """Return where the parts of a PUBLISH begin; raises PacketError if these are beyond its end."""
    head_end = 2 + int.from_bytes(content[:2]) + (2 if first & _QOS else 0)
    if not is_version_5:
        return PublishParts(head_end=head_end, property_bytes=0, payload_start=head_end)
    property_bytes = digit = 0
    for place in range(4):  # MQTT 5.0, 1.5.5: a variable byte integer has four bytes at most
        if head_end + place >= len(content):
            break
        digit = content[head_end + place]
        property_bytes |= (digit & 0x7F) << (7 * place)
        if digit < 0x80:
            start = head_end + place + 1 + property_bytes
            return PublishParts(head_end=head_end, property_bytes=property_bytes, payload_start=start)
    raise PacketError("properties without a length")


class BoundedClient(Client):
    """A client of paho-mqtt that unpacks no properties of messages, and keeps of long packets only their head.

    While `on_message` is called, ``unread_bytes`` and ``excess`` tell of that message. paho-mqtt has no public place
    for this: two methods of the range of versions in setup.py are extended.
    """

    _in_packet: Any

    def __init__(self, *arguments: Any, max_packet_bytes: int, **options: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        super().__init__(*arguments, **options)
        self.unread_bytes = 0  # of properties, and of a payload that is too long
        self.excess: str | None = None  # what is too long about the message
        self._is_version_5 = options["protocol"] is MQTTProtocolVersion.MQTTv5
        self._max_packet_bytes = max_packet_bytes

    def _packet_read(self) -> MQTTErrorCode:
        code = super()._packet_read()
        if self._in_packet["remaining_length"] > self._max_packet_bytes:  # and not yet all here
            del self._in_packet["packet"][_HEAD_BYTES:]
        return code

    def _packet_handle(self) -> MQTTErrorCode:
        packet = self._in_packet
        if packet["command"] & _KIND == _PUBLISH:
            packet["packet"] = self._bounded(packet["command"], packet["packet"], packet["remaining_length"])
        elif packet["remaining_length"] > MOST_ANSWER_BYTES:
            raise PacketError(f"an answer of {packet['remaining_length']} bytes, more than {MOST_ANSWER_BYTES}")
        return super()._packet_handle()

    def _bounded(self, first: int, content: bytearray, length: int) -> bytearray:
        """Return a PUBLISH without its properties; without its payload, too, if that is too long."""
        parts = read_publish(first, content, is_version_5=self._is_version_5)
        if length < parts.payload_start:
            raise PacketError("properties beyond the end of a packet")
        self.unread_bytes, self.excess = parts.property_bytes, excess_of(parts.property_bytes)
        if length > self._max_packet_bytes:
            self.unread_bytes = length - parts.head_end
            self.excess = self.excess or f"{length} bytes, more than {self._max_packet_bytes}"
            content = content[: parts.head_end] + (b"\0" if self._is_version_5 else b"")
        elif self._is_version_5:
            content[parts.head_end : parts.payload_start] = b"\0"
        return content
