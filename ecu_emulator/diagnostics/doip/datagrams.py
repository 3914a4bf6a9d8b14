"""What an entity says over UDP: who it is, how many sockets it has, whether the vehicle can be diagnosed."""

import struct
from dataclasses import dataclass
from typing import Final

from ecu_emulator.diagnostics.doip.messages import (
    ANSWERS,
    ANY_VERSION,
    HEADER_BYTES,
    IDENTIFICATIONS,
    IN_DATAGRAMS,
    HeaderNack,
    PayloadType,
    header_nack,
    header_of,
    message,
    refusal_of,
)
from ecu_emulator.diagnostics.table import DoipEntity

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
