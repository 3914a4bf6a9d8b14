"""Random conversations of every kind of transport, cut by their standards, and plain assemblers that know nothing else.

Nothing here is shared with the library: the assemblers keep what came and hand out what is full. ISO-TP is put
together by can-isotp, which listens.
"""

import logging
import random
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import isotp

from canlog.frames import EXTENDED_FLAG
from tests.support.transport_traffic import MS, Sent, Traffic

FD_SIZES = (8, 12, 16, 20, 24, 32, 48, 64)
LOST_RATIO = CUT_RATIO = 0.04
Message = tuple[int, bytes]  # identifier as a transfer has it, and contents
Piece = tuple[int, int, bytes, bool]  # wait [ms], identifier, data, whether the receiver says it


def _body(rng: random.Random, number: int, shortest: int, longest: int) -> bytes:
    """Return contents that no other message has, short and long ones as often."""
    length = min(longest, max(shortest, round(shortest * (longest / shortest) ** rng.random())))
    return (number.to_bytes(3) + rng.randbytes(length))[:length] if length > 3 else rng.randbytes(length)


def _padded(rng: random.Random, piece: bytes, size: int, paddings: tuple[bytes, ...]) -> bytes:
    padding = rng.choice((*paddings, b""))
    return piece.ljust(size, padding) if padding else piece


def _j1939(rng: random.Random, number: int, destination: int) -> tuple[Message, bytes, list[bytes], Callable[..., int]]:
    data, source, group = _body(rng, number, 9, 1785), rng.choice([0, 3, 0x21]), rng.choice([0xFECA, 0xFEEB, 0xEF00])
    specific = destination if group == 0xEF00 else group & 0xFF
    pieces = [data[start : start + 7] for start in range(0, len(data), 7)]
    packets = [bytes([index]) + piece for index, piece in enumerate(pieces, 1)]
    packets[-1] = _padded(rng, packets[-1], 8, (b"\xff", b"\xff", b"\0"))

    def frame_id(form: int, *, is_answer: bool = False) -> int:
        ends = (source, destination) if is_answer else (destination, source)
        return EXTENDED_FLAG | 7 << 26 | form << 16 | ends[0] << 8 | ends[1]

    head = len(data).to_bytes(2, "little") + bytes([len(packets), 0xFF]) + group.to_bytes(3, "little")
    message = (EXTENDED_FLAG | 7 << 26 | (group & 0x3FF00) << 8 | specific << 8 | source, data)
    return message, head, packets, frame_id


def bam(rng: random.Random, number: int, _: dict[int, int]) -> tuple[Message, list[Piece]]:
    """Return a message of J1939 for all."""
    message, head, packets, frame_id = _j1939(rng, number, 0xFF)
    gap_ms = rng.randint(10, 190)
    first = (0, frame_id(0xEC), b"\x20" + head, False)
    return message, [first, *((gap_ms, frame_id(0xEB), one, False) for one in packets)]


def rts(rng: random.Random, number: int, _: dict[int, int]) -> tuple[Message, list[Piece]]:
    """Return a message of J1939 between two, in blocks, with pauses, and packets asked for again."""
    message, head, packets, frame_id = _j1939(rng, number, 0xF9)
    group = head[-3:]
    pieces = [(0, frame_id(0xEC), b"\x10" + head, False)]
    start = 1
    while start <= len(packets):
        if rng.random() < 0.1:
            pieces.append((300, frame_id(0xEC, is_answer=True), b"\x11\0\xff\xff\xff" + group, True))
        some = min(rng.randint(1, 16), len(packets) - start + 1)
        pieces.append((3, frame_id(0xEC, is_answer=True), bytes([17, some, start, 0xFF, 0xFF]) + group, True))
        pieces += [(rng.randint(1, 20), frame_id(0xEB), one, False) for one in packets[start - 1 : start - 1 + some]]
        start += some if some < 2 or rng.random() < 0.9 else some - 1
    pieces.append((3, frame_id(0xEC, is_answer=True), b"\x13" + head, True))
    return message, pieces


def iso_tp(
    rng: random.Random, number: int, state: dict[int, int], *, is_fd: bool = False
) -> tuple[Message, list[Piece]]:
    """Return a message of ISO-TP with its flow control, single or not."""
    requests = ((0x7E0, 0x7E8), (0x7E1, 0x7E9), (0x18DA10F1 | EXTENDED_FLAG, 0x18DAF110 | EXTENDED_FLAG))
    pair = requests[state.setdefault(-1, rng.randrange(3))]
    own, other = pair if number % 2 else pair[::-1]
    size = rng.choice(FD_SIZES) if is_fd else 8
    data = b"\x22" + _body(rng, number, 3, 4200 if rng.random() < 0.1 else 300)
    padding = (bytes([rng.choice([0xCC, 0xAA, 0x55, 0xFF, 0])]),)
    if len(data) <= 7:
        return (own, data), [(0, own, _padded(rng, bytes([len(data)]) + data, 8, padding), False)]
    if is_fd and len(data) <= size - 2 and size > 8:
        full = next(one for one in FD_SIZES if one >= len(data) + 2)
        return (own, data), [(0, own, (bytes([0, len(data)]) + data).ljust(full, padding[0]), False)]
    is_long = len(data) > 4095
    head = b"\x10\0" + len(data).to_bytes(4) if is_long else (0x1000 | len(data)).to_bytes(2)
    pieces = [(0, own, head + data[: size - len(head)], False)]
    block, left, sequence = rng.choice([0, 0, 3, 8]), data[size - len(head) :], 1
    while left:
        if sequence == 1 or (block and (sequence - 1) % block == 0):
            waits = [rng.randint(1, 300) for _ in range(rng.choice([0, 0, 0, 2]))]
            pieces += [(wait_ms, other, bytes([0x31, block, 0]), True) for wait_ms in waits]
            pieces.append((rng.randint(1, 300), other, bytes([0x30, block, 0]), True))
        piece = bytes([0x20 | sequence % 16]) + left[: size - 1]
        if len(piece) < size and size > 8:
            piece = piece.ljust(next(one for one in FD_SIZES if one >= len(piece)), padding[0])
        elif len(piece) < size:
            piece = _padded(rng, piece, 8, padding)
        pieces.append((rng.randint(1, 30), own, piece, False))
        left, sequence = left[size - 1 :], sequence + 1
    return (own, data), pieces


def plain_j1939(frames: list[Sent]) -> Iterator[Message]:
    """Yield messages of J1939 transport: announced, numbered packets, all of them there."""
    found: dict[tuple[int, int], tuple[int, int, dict[int, bytes]]] = {}
    for one in frames:
        form, destination, source = (one.can_id >> shift & 0xFF for shift in (16, 8, 0))
        if form == 0xEC and one.data[:1] in {b"\x20", b"\x10"}:
            found.pop((source, destination), None)
            if len(one.data) == 8:
                found[source, destination] = (
                    int.from_bytes(one.data[1:3], "little"), int.from_bytes(one.data[5:8], "little"), {},
                )  # fmt: skip
        elif form == 0xEB and (source, destination) in found and one.data:
            length, group, packets = found[source, destination]
            packets[one.data[0]] = one.data[1:]
            whole = b"".join(packets.get(number, b"") for number in range(1, -(-length // 7) + 1))
            is_even = all(len(packets.get(number, b"")) == 7 for number in range(1, length // 7 + 1))
            if len(whole) >= length and is_even:
                del found[source, destination]
                specific = destination if group == 0xEF00 else group & 0xFF
                can_id = EXTENDED_FLAG | 7 << 26 | (group & 0x3FF00) << 8 | specific << 8 | source
                yield can_id, whole[:length]


def next_of(waiting: deque[isotp.CanMessage]) -> Callable[[float], isotp.CanMessage | None]:
    """Return what hands out frames one by one."""
    return lambda _: waiting.popleft() if waiting else None


def by_can_isotp(frames: list[Sent]) -> Iterator[Message]:
    """Yield messages of ISO-TP as can-isotp puts them together, of each sender by a listener of its own."""
    for can_id in sorted({one.can_id for one in frames}):
        waiting = deque(
            isotp.CanMessage(
                arbitration_id=can_id & 0x1FFF_FFFF,
                data=one.data,
                dlc=len(one.data),
                extended_id=can_id > 0x7FF,
                is_fd=len(one.data) > 8,
            )
            for one in frames
            if one.can_id == can_id and one.data[0] >> 4 != 3  # nothing is sent here that flow control could be for
        )
        mode = isotp.AddressingMode.Normal_29bits if can_id > 0x7FF else isotp.AddressingMode.Normal_11bits
        options = {
            "listen_mode": True,
            "rx_consecutive_frame_timeout": 3_600_000,
            "max_frame_size": 8_000,
            "can_fd": True,
        }
        layer = isotp.TransportLayerLogic(
            next_of(waiting),
            lambda _: None,
            isotp.Address(mode, txid=0x123, rxid=can_id & 0x1FFF_FFFF),
            params=options,
            error_handler=lambda _: None,
        )
        while waiting:
            layer.process()
            while (data := layer.recv()) is not None:
                yield can_id, bytes(data)


Maker = Callable[[random.Random, int, dict[int, int]], tuple[Message, list[Piece]]]
logging.getLogger("isotp").setLevel(logging.CRITICAL)  # it tells of every frame that is lost
KINDS: dict[str, tuple[Maker, Callable[[list[Sent]], Iterator[Message]]]] = {
    "J1939 for all": (bam, plain_j1939),
    "J1939 between two": (rts, plain_j1939),
    "ISO-TP": (iso_tp, by_can_isotp),
    "ISO-TP over CAN FD": (lambda *one: iso_tp(*one, is_fd=True), by_can_isotp),
}


def conversation(rng: random.Random, maker: Maker, messages: int) -> Traffic:
    """Return messages one after the other, or of several senders at a time where they do not answer each other."""
    t_ns, state, frames, sent, busy_ns = 0, dict[int, int](), list[Sent](), list[Message](), dict[int, int]()
    for number in range(messages):
        message, pieces = maker(rng, number, state)
        sender = message[0] & 0xFF if maker in {bam, rts} else message[0]
        at_ns = max(t_ns, busy_ns.get(sender, 0)) + rng.randint(2, 40) * MS
        first_ns = at_ns
        for wait_ms, can_id, data, is_answer in pieces:
            at_ns += wait_ms * MS
            frames.append(Sent(t_ns=at_ns, can_id=can_id, data=data, message=number, is_answer=is_answer))
        busy_ns[sender] = at_ns
        t_ns = first_ns if maker in {bam, rts} else at_ns
        sent.append(message)
    order = sorted(zip(frames, count(), strict=False), key=lambda one: (one[0].t_ns, one[1]))
    return Traffic(frames=tuple(one for one, _ in order), messages=tuple(sent))


def damaged(rng: random.Random, frames: tuple[Sent, ...], damage: str) -> list[Sent]:
    """Return frames of which some are lost, or cut."""
    if damage == "lost":
        return [one for one in frames if rng.random() >= LOST_RATIO]
    if damage == "cut":
        return [
            replace(one, data=one.data[: rng.randint(1, 7)]) if not one.is_answer and rng.random() < CUT_RATIO else one
            for one in frames
        ]
    return list(frames)
