"""Logs with random payloads of every length for the messages of any database."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal

FD_SIZES: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
CLASSIC_BYTES: Final = 8
FD_BYTES: Final = 64
WHOLE_SHARE: Final = 0.5  # of the frames that are as long as their message
FD_SHARE: Final = 0.7  # of the frames of up to eight bytes of messages that need more


@dataclass(frozen=True, slots=True)
class SentFrame:
    """One frame of a log."""

    place: int  # of its message among those that were drawn
    payload: bytes
    is_fd: bool


def random_frames(messages: Sequence[Message], count: int, rng: np.random.Generator) -> list[SentFrame]:
    """Return frames of all messages in random order: zeros and ones, then random bytes, whole, short and too long."""
    frames = [
        SentFrame(place, payload, is_fd=_is_fd(message, len(payload), rng))
        for place, message in enumerate(messages)
        for payload in _payloads(message, count, rng)
    ]
    return [frames[place] for place in rng.permutation(len(frames))]


def write_candump(path: Path, messages: Sequence[Message], frames: Sequence[SentFrame]) -> None:
    """Write a candump log; its frames are a microsecond apart."""
    with path.open("w", encoding="ascii") as log:
        for number, frame in enumerate(frames):
            message = messages[frame.place]
            identifier = f"{message.frame_id:08X}" if message.is_extended_frame else f"{message.frame_id:03X}"
            mark = "##0" if frame.is_fd else "#"
            log.write(f"(1.{number:06d}) can0 {identifier}{mark}{frame.payload.hex().upper()}\n")


def _payloads(message: Message, count: int, rng: np.random.Generator) -> list[bytes]:
    whole = next(size for size in FD_SIZES if size >= min(message.length, FD_BYTES))
    sizes = np.where(rng.random(count) < WHOLE_SHARE, whole, rng.choice(FD_SIZES[: 9 if whole <= 8 else None], count))
    sizes[:2] = whole
    payloads = [bytearray(rng.bytes(size)) for size in sizes.tolist()]
    payloads[0], payloads[1] = bytearray(whole), bytearray(b"\xff" * whole)
    for payload in payloads[2::2]:
        _select_pages(message, payload, rng)
    return [bytes(payload) for payload in payloads]


def _is_fd(message: Message, size: int, rng: np.random.Generator) -> bool:
    return size > CLASSIC_BYTES or (message.length > CLASSIC_BYTES and bool(rng.random() < FD_SHARE))


def _select_pages(message: Message, payload: bytearray, rng: np.random.Generator) -> None:
    """Let the multiplexers of a payload select pages that there are."""
    by_name = {signal.name: signal for signal in message.signals}
    for signal in rng.permutation(np.array(message.signals, object)).tolist():
        if signal.multiplexer_ids and signal.multiplexer_signal in by_name:
            page = int(rng.choice(np.array(signal.multiplexer_ids, object)))
            _set_bits(payload, by_name[signal.multiplexer_signal], page)


def _set_bits(payload: bytearray, signal: Signal, value: int) -> None:
    """Write the bits of a raw value one by one, as far as the payload reaches."""
    is_big = signal.byte_order == "big_endian"
    first = 8 * (signal.start // 8) + 7 - signal.start % 8 if is_big else signal.start
    for number in range(signal.length):
        bit = value >> (signal.length - 1 - number if is_big else number) & 1
        byte, inside = divmod(first + number, 8)
        if byte < len(payload):
            mask = 0x80 >> inside if is_big else 1 << inside
            payload[byte] = payload[byte] | mask if bit else payload[byte] & ~mask & 0xFF
