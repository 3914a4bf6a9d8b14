"""Messages longer than a frame, cut into frames by nothing of ours: can-isotp."""

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import isotp
import numpy as np

from canlog.frames import EXTENDED_FLAG, FD_FLAG, FrameBatch

MS = 1_000_000
NEVER_MS = 3_600_000
PAIRS = (0x18DA10F1 | EXTENDED_FLAG, 0x18DAF110 | EXTENDED_FLAG), (0x7E0, 0x7E8)  # of requests and answers


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """A frame on the bus, and the number of the message that it is part of, or speaks of as its receiver."""

    t_ns: int
    can_id: int
    data: bytes
    message: int
    is_answer: bool = False  # flow control and the like: carries nothing of the message


@dataclass(frozen=True, slots=True, kw_only=True)
class Traffic:
    """Frames, and the messages that they carry: identifier as a transfer has it, and contents."""

    frames: tuple[Sent, ...]
    messages: tuple[tuple[int, bytes], ...]


def generator(seed: int) -> random.Random:
    """Return chance that can be repeated."""
    return random.Random(seed)  # noqa: S311 - no secrets


def batch_of(frames: "list[Sent] | tuple[Sent, ...]") -> FrameBatch:
    """Return frames as columns."""
    width = 64 if any(len(one.data) > 8 for one in frames) else 8
    data = np.zeros((len(frames), width), np.uint8)
    for row, one in enumerate(frames):
        data[row, : len(one.data)] = list(one.data)
    return FrameBatch(
        t_ns=np.array([one.t_ns for one in frames], np.int64),
        can_id=np.array([one.can_id for one in frames], np.uint32),
        length=np.array([len(one.data) for one in frames], np.uint8),
        data=data,
        flags=np.array([FD_FLAG if len(one.data) > 8 else 0 for one in frames], np.uint8),
    )


def contents(rng: random.Random, number: int, shortest: int, longest: int) -> bytes:
    """Return bytes of which no two messages have the same."""
    length = rng.randint(max(shortest, 4), longest)
    return number.to_bytes(4) + rng.randbytes(length - 4)


def iso_tp(rng: random.Random, count: int, *, block: int = 0, is_fd: bool = False) -> Traffic:
    """Return a tester's requests and a controller's answers, each cut by can-isotp, flow control included."""
    ids = rng.choice(PAIRS)
    bus: deque[tuple[int, bytes]] = deque()
    waiting: tuple[deque[bytes], deque[bytes]] = (deque(), deque())
    options = {"blocksize": block, "stmin": 0, "tx_data_length": 64 if is_fd else 8, "can_fd": is_fd}
    # can-isotp looks at the clock of the machine, which may be busy.
    options |= {"rx_flowcontrol_timeout": NEVER_MS, "rx_consecutive_frame_timeout": NEVER_MS}

    def side(own: int) -> isotp.TransportLayerLogic:
        def send(message: isotp.CanMessage) -> None:
            bus.append((own, bytes(message.data)))
            waiting[1 - own].append(bytes(message.data))

        def receive(timeout: float) -> isotp.CanMessage | None:
            del timeout
            data = waiting[own].popleft() if waiting[own] else None
            return (
                None
                if data is None
                else isotp.CanMessage(
                    arbitration_id=ids[1 - own] & 0x1FFF_FFFF,
                    data=data,
                    dlc=len(data),
                    extended_id=ids[0] > 0x7FF,
                    is_fd=is_fd,
                )
            )

        mode = isotp.AddressingMode.Normal_29bits if ids[0] > 0x7FF else isotp.AddressingMode.Normal_11bits
        address = isotp.Address(mode, txid=ids[own] & 0x1FFF_FFFF, rxid=ids[1 - own] & 0x1FFF_FFFF)
        return isotp.TransportLayerLogic(receive, send, address, params=options)

    sides, t_ns, frames, messages = (side(0), side(1)), 0, list[Sent](), list[tuple[int, bytes]]()
    for number in range(count):
        own = number % 2
        data = contents(rng, number, 4, 60 if rng.random() < 0.7 else 300)
        messages.append((ids[own], data))
        sides[own].send(data)
        t_ns += rng.randint(5, 60) * MS
        while sides[own].transmitting() or bus or waiting[0] or waiting[1]:
            for one in sides:
                one.process()
            while bus:
                sender, cut = bus.popleft()
                t_ns += rng.randint(1, 5) * MS // 2
                is_answer = sender != own
                frames.append(Sent(t_ns=t_ns, can_id=ids[sender], data=cut, message=number, is_answer=is_answer))
        received = sides[1 - own].recv()
        assert received is not None
        assert bytes(received) == data
    return Traffic(frames=tuple(frames), messages=tuple(messages))


MAKERS: dict[str, Callable[[random.Random, int], Traffic]] = {
    "iso-tp": iso_tp,
    "iso-tp in blocks": lambda rng, count: iso_tp(rng, count, block=3),
    "iso-tp over CAN FD": lambda rng, count: iso_tp(rng, count, is_fd=True),
}
