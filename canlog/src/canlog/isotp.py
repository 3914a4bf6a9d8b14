"""ISO-TP (ISO 15765-2) as a third party hears it: messages of several frames, put together from both sides' frames."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from canlog.frames import FrameBatch

SINGLE, FIRST, CONSECUTIVE, FLOW_CONTROL = range(4)
CONTINUE, _WAIT, OVERFLOW = range(3)  # status of a flow control frame
LIMIT_NS: Final = 1_000_000_000  # N_Cr and N_Bs: longest silence between two frames
CLASSIC_BYTES: Final = 8
SEQUENCE: Final = 16
SHORTEST_LONG: Final = 8  # a message of fewer bytes fits into a single frame, of CAN FD or not
LONGEST: Final = 1 << 20  # 32 bits could state more; no controller has it
LONGEST_CLASSIC: Final = 0xFFF
TESTER_PRESENT: Final = 0x3E

Sender = tuple[int, int]  # channel, identifier with flags


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """A whole message."""

    channel: int
    can_id: int  # of the sender's frames, with flags
    first_ns: int  # time of its first frame
    last_ns: int  # time of its last frame
    frames: int
    data: bytes


@dataclass(slots=True)
class _Partial:
    """A message of which frames are missing."""

    first_ns: int
    last_ns: int
    length: int
    data: bytearray
    frame_bytes: int  # of each frame but the last
    frames: int = 1
    sequence: int = 1  # of the next frame
    is_allowed: bool = False  # a flow control frame came
    block: int = 0  # frames that flow control allows at a time; 0: all
    allowed: int = 0  # frames of the block that have not come yet


class Reassembler:
    """Puts the messages of some pairs of identifiers together, batch by batch.

    A message of which a frame is missing, cut or later than ``LIMIT_NS`` is dropped.

    Parameters
    ----------
    pairs
        Identifiers, with flags, of requests and of their answers.
    """

    def __init__(self, pairs: Collection[tuple[int, int]]) -> None:
        self._peers = {can_id: peer for pair in pairs for can_id, peer in (pair, pair[::-1])}
        self._partial: dict[Sender, _Partial] = {}

    def feed(self, batch: FrameBatch) -> list[Transfer]:
        """Return the messages that frames complete: those of the pairs, and of requests to all controllers."""
        transfers, payload, width = list[Transfer](), batch.data.tobytes(), batch.data.shape[1]
        columns = (batch.t_ns.tolist(), batch.channel.tolist(), batch.can_id.tolist(), batch.length.tolist())
        for row, (t_ns, channel, can_id, length) in enumerate(zip(*columns, strict=True)):
            peer = (channel, self._peers[can_id]) if can_id in self._peers else None
            data = payload[row * width : row * width + length]
            if transfer := self._add(t_ns, (channel, can_id), peer, data):
                transfers.append(transfer)
        return transfers

    def _add(self, t_ns: int, sender: Sender, peer: Sender | None, data: bytes) -> Transfer | None:
        """Return the message that a frame completes; ``peer`` is who answers its sender, None if that is nobody."""
        kind = data[0] >> 4 if data else -1
        if kind == SINGLE:
            return self._single(t_ns, sender, peer, data)
        if kind == FIRST:
            self._begin(t_ns, sender, peer, data)
        elif kind == CONSECUTIVE:
            return self._continue(t_ns, sender, peer, data)
        elif kind == FLOW_CONTROL and peer is not None:
            self._control(t_ns, sender, peer, data)
        return None

    def _single(self, t_ns: int, sender: Sender, peer: Sender | None, data: bytes) -> Transfer | None:
        length, start = data[0] & 0x0F, 1
        if length == 0 and len(data) > CLASSIC_BYTES:
            length, start = data[1], 2
        if length == 0 or start + length > len(data):
            return None
        self._drop(sender)
        if data[start] != TESTER_PRESENT:
            self._drop(peer)  # who asks again waits for no answer any more
        channel, can_id = sender
        return Transfer(
            channel=channel, can_id=can_id, first_ns=t_ns, last_ns=t_ns, frames=1, data=data[start : start + length]
        )

    def _begin(self, t_ns: int, sender: Sender, peer: Sender | None, data: bytes) -> None:
        self._drop(sender)
        self._drop(peer)
        length, start = (data[0] & 0x0F) << 8 | int.from_bytes(data[1:2]), 2
        if length == 0:
            length, start = int.from_bytes(data[2:6]), 6
        if len(data) >= CLASSIC_BYTES and max(SHORTEST_LONG, len(data) - start + 1) <= length <= LONGEST:
            self._partial[sender] = _Partial(t_ns, t_ns, length, bytearray(data[start:]), frame_bytes=len(data))

    def _continue(self, t_ns: int, sender: Sender, peer: Sender | None, data: bytes) -> Transfer | None:
        message = self._partial.get(sender)
        if message is None or t_ns - message.last_ns > LIMIT_NS:
            self._drop(sender)
            self._drop(peer)  # who sends has received what the other side sent
            return None
        least_bytes = min(message.frame_bytes, message.length - len(message.data) + 1)
        if data[0] & 0x0F != message.sequence or len(data) < least_bytes:
            self._drop(sender)
            return None
        message.data += data[1:]
        message.frames, message.last_ns = message.frames + 1, t_ns
        message.sequence = (message.sequence + 1) % SEQUENCE
        message.allowed = (message.allowed - 1) % message.block if message.block else 0
        if len(message.data) < message.length:
            return None
        self._drop(sender)
        channel, can_id = sender
        return Transfer(
            channel=channel,
            can_id=can_id,
            first_ns=message.first_ns,
            last_ns=t_ns,
            frames=message.frames,
            data=bytes(message.data[: message.length]),
        )

    def _control(self, t_ns: int, receiver: Sender, sender: Sender, data: bytes) -> None:
        self._drop(receiver)  # who receives has ended what it sent
        message = self._partial.get(sender)
        if message is None:
            return
        status, block = data[0] & 0x0F, data[1] if len(data) > 1 else 0
        is_early = message.is_allowed and (message.allowed or not message.block)  # frames are lost, or it is another's
        if status == OVERFLOW or (status == CONTINUE and is_early):
            self._drop(sender)
            return
        message.last_ns = t_ns
        if status == CONTINUE:
            message.is_allowed, message.block, message.allowed = True, block, block

    def _drop(self, sender: Sender | None) -> None:
        if sender is not None:
            self._partial.pop(sender, None)


def segments(payload: bytes) -> list[bytes]:
    """Return the frames of eight bytes that carry a message; flow control comes after the first of several.

    Raises ValueError if the message has more than 4095 bytes.
    """
    if len(payload) < CLASSIC_BYTES:
        return [bytes([len(payload)]) + payload]
    if len(payload) > LONGEST_CLASSIC:
        raise ValueError(f"a message of {len(payload)} bytes is too long")
    first = bytes([FIRST << 4 | len(payload) >> 8, len(payload) & 0xFF]) + payload[:6]
    rest = [payload[at : at + 7] for at in range(6, len(payload), 7)]
    return [first, *(bytes([CONSECUTIVE << 4 | number % SEQUENCE]) + part for number, part in enumerate(rest, 1))]
