"""Messages that are all properties, from a vehicle with a certificate of its own; `studies.fleet_hostile` plays them.

Mosquitto's ``message_size_limit`` counts payloads alone, and paho-mqtt unpacks 50,000 user properties in 4.5 s.
"""

import ssl
import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from socket import create_connection
from typing import Final

USER_PROPERTY: Final = bytes([38, 0, 0, 0, 0])  # without a name and a value: five bytes
LONG_PROPERTY: Final = b"\x26" + 2 * (b"\xff\xff" + b"x" * 65_535)
UNPACKED, UNPACKED_PROPERTIES = 10, 50_000  # messages that take long to unpack, and the properties of each
KEPT, KEPT_PROPERTIES = 100, 115  # messages that a broker is to keep: 15 MB of properties each, no payload
_PUBACK: Final = b"\x40"
_ANSWER_S: Final = 20.0  # for what a broker neither takes nor refuses


def of_length(length: int) -> bytes:
    """Return a variable byte integer of MQTT."""
    digits = bytearray()
    while length >= 128:
        digits.append(128 | length % 128)
        length //= 128
    return bytes([*digits, length])


def delivery(
    topic: str, properties: bytes, payload: bytes = b"", *, packet_id: int, is_retained: bool = False
) -> bytes:
    """Return a PUBLISH of MQTT 5 with QoS 1."""
    name = topic.encode()
    head = len(name).to_bytes(2) + name + packet_id.to_bytes(2) + of_length(len(properties))
    length = of_length(len(head) + len(properties) + len(payload))
    return b"".join((b"\x33" if is_retained else b"\x32", length, head, properties, payload))


def connect_packet(identifier: str) -> bytes:
    """Return a CONNECT of MQTT 5: a clean start, no properties."""
    name = identifier.encode()
    content = b"\x00\x04MQTT\x05\x02\x00\x3c\x00" + len(name).to_bytes(2) + name
    return b"\x10" + of_length(len(content)) + content


class RawVehicle:
    """A vehicle that writes packets as they are.

    Parameters
    ----------
    context :
        With the vehicle's certificate; without one the broker takes everybody.
    """

    def __init__(self, port: int, identifier: str, context: ssl.SSLContext | None = None) -> None:
        self._port = port
        self._identifier = identifier
        self._context = context
        self._is_over = threading.Event()

    def send(self, packets: Iterable[bytes]) -> int:
        """Send each packet over a connection of its own, until `stop`, and return how many the broker took."""
        return sum(self._is_taken(packet) for packet in packets if not self._is_over.is_set())

    def stop(self) -> None:
        """Let `send` return after the packet at hand."""
        self._is_over.set()

    def _is_taken(self, packet: bytes) -> bool:
        with ExitStack() as stack, suppress(OSError):
            connection = stack.enter_context(create_connection(("127.0.0.1", self._port), _ANSWER_S))
            if self._context is not None:
                connection = stack.enter_context(self._context.wrap_socket(connection, server_hostname="127.0.0.1"))
            connection.sendall(connect_packet(self._identifier))
            connection.recv(4096)
            connection.sendall(packet)
            return connection.recv(1) == _PUBACK
        return False


def hostile_context(folder: Path, name: str) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=str(folder / "ca.crt"))
    context.load_cert_chain(folder / f"{name}.crt", folder / f"{name}.key")
    return context


def slow_messages(topic: str, count: int = UNPACKED) -> Iterator[bytes]:
    """Yield messages of 250 kB that take long to unpack."""
    properties = USER_PROPERTY * UNPACKED_PROPERTIES
    for number in range(1, count + 1):
        yield delivery(topic, properties, b"%d" % number, packet_id=number)


def filling_messages(topic: str, count: int = KEPT, properties: int = KEPT_PROPERTIES) -> Iterator[bytes]:
    """Yield messages that fill a broker, unless it counts their properties."""
    content = LONG_PROPERTY * properties
    for number in range(1, count + 1):
        yield delivery(topic, content, packet_id=number)


def peak_bytes(pid: int) -> int:
    """Return the most memory that a process has had (VmHWM)."""
    text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return 1024 * int(text.partition("VmHWM:")[2].split()[0])
