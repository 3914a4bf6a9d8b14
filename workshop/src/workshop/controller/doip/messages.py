"""Messages of ISO 13400-2 as bytes: what a header can be refused for, what an entity says over TCP and over UDP."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from workshop.controller.table import DoipEntity

HEADER_BYTES: Final = 8
VERSION_2012: Final = 0x02
VERSION_2019: Final = 0x03
ANY_VERSION: Final = 0xFF  # of a tester that asks who is there and does not know yet
MOST_PAYLOAD_BYTES: Final = 0x10000  # of a message, whatever it is; what is longer is passed over
ADDRESSES_BYTES: Final = 4  # source and target before the data of a diagnostic message
MOST_ECHO_BYTES: Final = 64  # of a diagnostic message that its acknowledgement repeats
_HEADER: Final = struct.Struct(">BBHL")


class PayloadType(IntEnum):
    HEADER_NACK = 0x0000
    IDENTIFY = 0x0001
    IDENTIFY_BY_EID = 0x0002
    IDENTIFY_BY_VIN = 0x0003
    ANNOUNCEMENT = 0x0004  # also the answer to the three before it
    ACTIVATE = 0x0005
    ACTIVATED = 0x0006
    ALIVE_CHECK = 0x0007
    ALIVE = 0x0008
    ENTITY_STATUS = 0x4001
    ENTITY_STATUS_TOLD = 0x4002
    POWER_MODE = 0x4003
    POWER_MODE_TOLD = 0x4004
    DIAGNOSTIC = 0x8001
    DIAGNOSTIC_ACK = 0x8002
    DIAGNOSTIC_NACK = 0x8003


class HeaderNack(IntEnum):
    """Why a header is refused."""

    INCORRECT_PATTERN = 0x00
    UNKNOWN_PAYLOAD_TYPE = 0x01
    TOO_LARGE = 0x02
    OUT_OF_MEMORY = 0x03
    INVALID_LENGTH = 0x04


class DiagnosticNack(IntEnum):
    """Why a diagnostic message does not reach the controller."""

    INVALID_SOURCE = 0x02
    UNKNOWN_TARGET = 0x03
    TOO_LARGE = 0x04
    OUT_OF_MEMORY = 0x05


class Activation(IntEnum):
    """What becomes of a routing activation."""

    UNKNOWN_SOURCE = 0x00
    NO_SOCKET_LEFT = 0x01
    OTHER_SOURCE = 0x02  # than the one this socket was activated for
    SOURCE_IN_USE = 0x03  # on another socket, whose tester is alive
    UNSUPPORTED_TYPE = 0x06
    ACTIVATED = 0x10


CLOSING_NACKS: Final = frozenset({HeaderNack.INCORRECT_PATTERN, HeaderNack.INVALID_LENGTH})
"""After these a stream cannot be trusted any more: its socket is closed."""

ON_SOCKETS: Final[Mapping[int, range]] = {
    PayloadType.ACTIVATE: range(7, 12, 4),
    PayloadType.ALIVE_CHECK: range(1),
    PayloadType.ALIVE: range(2, 3),
    PayloadType.DIAGNOSTIC: range(ADDRESSES_BYTES + 1, MOST_PAYLOAD_BYTES + 1),
}
"""What a tester may send over TCP, with the lengths of its payload."""

IN_DATAGRAMS: Final[Mapping[int, range]] = {
    PayloadType.IDENTIFY: range(1),
    PayloadType.IDENTIFY_BY_EID: range(6, 7),
    PayloadType.IDENTIFY_BY_VIN: range(17, 18),
    PayloadType.ENTITY_STATUS: range(1),
    PayloadType.POWER_MODE: range(1),
}
"""What a tester may send over UDP, likewise."""

IDENTIFICATIONS: Final = frozenset({PayloadType.IDENTIFY, PayloadType.IDENTIFY_BY_EID, PayloadType.IDENTIFY_BY_VIN})
"""Requests of testers that do not know yet who is there, nor which version they speak."""

ANSWERS: Final = frozenset(
    {
        PayloadType.HEADER_NACK,
        PayloadType.ANNOUNCEMENT,
        PayloadType.ACTIVATED,
        PayloadType.ENTITY_STATUS_TOLD,
        PayloadType.POWER_MODE_TOLD,
        PayloadType.DIAGNOSTIC_ACK,
        PayloadType.DIAGNOSTIC_NACK,
    }
)
"""What entities and testers answer: never refused, or two of them would refuse each other's refusals for ever."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """The first eight bytes of a message."""

    version: int
    inverse: int
    payload_type: int
    payload_bytes: int


def header_of(data: bytes) -> Header | None:
    """Return the header that data begin with, None while they are too short."""
    if len(data) < HEADER_BYTES:
        return None
    version, inverse, payload_type, payload_bytes = _HEADER.unpack_from(data)
    return Header(version=version, inverse=inverse, payload_type=payload_type, payload_bytes=payload_bytes)


def refusal_of(header: Header, known: Mapping[int, range]) -> HeaderNack | None:
    """Return why a header is refused, in the order of the standard's header handler; None if it is not.

    Parameters
    ----------
    header
        What came.
    known
        The types that may come this way, with the lengths of their payload.
    """
    if not _has_pattern(header, known):
        return HeaderNack.INCORRECT_PATTERN
    if header.payload_type in ANSWERS:
        return HeaderNack.TOO_LARGE if header.payload_bytes > MOST_PAYLOAD_BYTES else None
    if header.payload_type not in known:
        return HeaderNack.UNKNOWN_PAYLOAD_TYPE
    if header.payload_bytes > MOST_PAYLOAD_BYTES:
        return HeaderNack.TOO_LARGE
    if header.payload_bytes not in known[header.payload_type]:
        return HeaderNack.INVALID_LENGTH
    return None


def _has_pattern(header: Header, known: Mapping[int, range]) -> bool:
    """Return whether a message says which version it is of, twice, and the version is known."""
    is_asking = header.payload_type in IDENTIFICATIONS and header.payload_type in known
    versions = {VERSION_2012, VERSION_2019, *((ANY_VERSION,) if is_asking else ())}
    return header.version in versions and header.inverse == header.version ^ 0xFF


def message(version: int, payload_type: PayloadType, payload: bytes = b"") -> bytes:
    return _HEADER.pack(version, version ^ 0xFF, payload_type, len(payload)) + payload


def header_nack(version: int, code: HeaderNack) -> bytes:
    """Return what is said to a header that is refused."""
    return message(version, PayloadType.HEADER_NACK, bytes([code]))


def activation_response(version: int, tester: int, entity: int, code: Activation) -> bytes:
    """Return what is said to a routing activation; the last four bytes are reserved by the standard."""
    return message(version, PayloadType.ACTIVATED, struct.pack(">HHBL", tester, entity, code, 0))


def diagnostic(version: int, source: int, target: int, data: bytes) -> bytes:
    return message(version, PayloadType.DIAGNOSTIC, struct.pack(">HH", source, target) + data)


def acknowledgement(version: int, source: int, target: int, code: DiagnosticNack | None, data: bytes) -> bytes:
    """Return what is said to a diagnostic message from ``target``: it has been taken if there is no code."""
    kind = PayloadType.DIAGNOSTIC_ACK if code is None else PayloadType.DIAGNOSTIC_NACK
    return message(version, kind, struct.pack(">HHB", source, target, code or 0) + data[:MOST_ECHO_BYTES])


VIN_BYTES: Final = 17
NODE: Final = 0x01  # not a gateway: there is no other controller behind it
READY: Final = 0x01  # power mode
NO_FURTHER_ACTION: Final = 0x00
IS_SYNCHRONISED: Final = 0x00
IS_NOT_SYNCHRONISED: Final = 0x10  # VIN and group are not known yet


@dataclass(frozen=True, slots=True, kw_only=True)
class DatagramReply:
    """What is sent back; an identification after a random pause, since all entities are asked at once."""

    data: bytes
    is_identification: bool


def announcement(entity: DoipEntity, vin: bytes, version: int) -> bytes:
    """Return what an entity says of itself when it starts and when it is asked; a VIN that is none is all zeros."""
    is_known = len(vin) == VIN_BYTES
    payload = struct.pack(
        ">17sH6s6sBB",
        vin if is_known else bytes(VIN_BYTES),
        entity.logical_address,
        entity.eid.to_bytes(6, "big"),
        entity.gid.to_bytes(6, "big"),
        NO_FURTHER_ACTION,
        IS_SYNCHRONISED if is_known else IS_NOT_SYNCHRONISED,
    )
    return message(version, PayloadType.ANNOUNCEMENT, payload)


def datagram_reply(entity: DoipEntity, vin: bytes, open_sockets: int, data: bytes) -> DatagramReply | None:
    """Return what a datagram is answered with; None if it asks for another vehicle or is an answer itself.

    Parameters
    ----------
    entity, vin
        Who is asked.
    open_sockets
        How many TCP connections there are now.
    data
        One datagram, which holds one message.
    """
    header = header_of(data)
    refusal = HeaderNack.INCORRECT_PATTERN if header is None else refusal_of(header, IN_DATAGRAMS)
    if header is None or refusal is HeaderNack.INCORRECT_PATTERN:
        return _said(header_nack(entity.version, HeaderNack.INCORRECT_PATTERN))
    if header.payload_type in ANSWERS:
        return None
    version = entity.version if header.version == ANY_VERSION else header.version
    payload = data[HEADER_BYTES:]
    if refusal is None and len(payload) != header.payload_bytes:
        refusal = HeaderNack.INVALID_LENGTH
    if refusal is not None:
        return _said(header_nack(version, refusal))
    return _told(entity, vin, open_sockets, PayloadType(header.payload_type), payload, version)


def _told(
    entity: DoipEntity, vin: bytes, open_sockets: int, kind: PayloadType, payload: bytes, version: int
) -> DatagramReply | None:
    if kind in IDENTIFICATIONS:
        is_meant = kind is PayloadType.IDENTIFY or payload in {entity.eid.to_bytes(6, "big"), vin}
        return DatagramReply(data=announcement(entity, vin, version), is_identification=True) if is_meant else None
    if kind is PayloadType.POWER_MODE:
        return _said(message(version, PayloadType.POWER_MODE_TOLD, bytes([READY])))
    status = struct.pack(">BBBL", NODE, entity.most_sockets, min(open_sockets, 0xFF), entity.most_request_bytes)
    return _said(message(version, PayloadType.ENTITY_STATUS_TOLD, status))


def _said(data: bytes) -> DatagramReply:
    return DatagramReply(data=data, is_identification=False)
