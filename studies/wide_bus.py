"""A made-up bus of a whole vehicle: a hundred messages with 700 signals, whose values move as a vehicle's do.

Some values never change, some change now and then, some move slowly, some count, and a few are noise, as checksums are.
Everything follows from the number of frames and the seed.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

from canlog.arrays import FloatArray, Int64Array, UInt8Array
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats import open_log

FIRST_ID: Final = 0x100
PERIODS_S: Final = (0.01,) * 20 + (0.02,) * 20 + (0.05,) * 20 + (0.1,) * 20 + (0.2,) * 10 + (1.0,) * 10
PAGED_EVERY: Final = 10  # one message in so many is multiplexed
PAGES: Final = 4
FRAMES_PER_WRITE: Final = 100_000
# First bit in the order of transmission, length, scale, offset, signed.
Place = tuple[int, int, float, float, bool]

MIXED: Final[tuple[Place, ...]] = (
    (0, 8, 1, 0, False),
    (8, 4, 1, 0, False),
    (12, 16, 0.25, 0, False),
    (28, 12, 0.1, -100, True),
    (40, 13, 0.04, 0, False),
    (53, 3, 1, 0, False),
    (56, 8, 1, -40, False),
)
"""Seven signals that fill a frame."""
PAGED: Final[tuple[Place, ...]] = ((0, 2, 1, 0, False), *MIXED[2:5], *MIXED[2:5])
SLOW_HZ: Final = 0.05


def signal(name: str, place: Place, *, is_big: bool, page: int | None = None, is_multiplexer: bool = False) -> Signal:
    """Return one signal."""
    first, length, scale, offset, is_signed = place
    return Signal(
        name,
        start=8 * (first // 8) + 7 - first % 8 if is_big else first,
        length=length,
        byte_order="big_endian" if is_big else "little_endian",
        is_signed=is_signed,
        conversion=BaseConversion.factory(scale=scale, offset=offset),
        is_multiplexer=is_multiplexer,
        multiplexer_ids=None if page is None else [page],
        multiplexer_signal=None if page is None else "S0",
    )


def places(number: int) -> tuple[Place, ...]:
    """Return where the seven signals of a message lie; of a multiplexed one the first selects the page."""
    return PAGED if is_paged(number) else MIXED


def is_paged(number: int) -> bool:
    """Return whether a message is multiplexed."""
    return number % PAGED_EVERY == PAGED_EVERY - 1


def page_of(number: int, place: int) -> int | None:
    """Return on which page of its message a signal is; None: in every frame."""
    return (place - 1) % PAGES if is_paged(number) and place else None


def message(number: int) -> Message:
    """Return one of the messages: every other one is big-endian."""
    return Message(
        FIRST_ID + number,
        f"M{number}",
        8,
        [
            signal(
                f"S{k}",
                place,
                is_big=number % 2 == 1,
                page=page_of(number, k),
                is_multiplexer=is_paged(number) and not k,
            )
            for k, place in enumerate(places(number))
        ],
        cycle_time=round(1000 * PERIODS_S[number]),
        strict=not is_paged(number),
    )


def database() -> Database:
    """Return the hundred messages."""
    return Database([message(number) for number in range(len(PERIODS_S))])


@dataclass(frozen=True, slots=True)
class Bus:
    """Frames in the order of time: when each is due, of which message it is, and the how manieth of that."""

    t_s: FloatArray
    number: Int64Array
    turn: Int64Array

    @classmethod
    def of(cls, count: int) -> "Bus":
        """Return the first ``count`` frames."""
        rate_hz = sum(1 / period_s for period_s in PERIODS_S)
        duration_s = 1.05 * count / rate_hz + 2 * max(PERIODS_S)
        own = [np.arange(0, duration_s, period_s) for period_s in PERIODS_S]
        t_s = np.concatenate([times + number * 1e-4 for number, times in enumerate(own)])
        number = np.repeat(np.arange(len(own)), [len(times) for times in own])
        turn = np.concatenate([np.arange(len(times)) for times in own])
        order = np.argsort(t_s, kind="stable")[:count]
        return cls(t_s[order], number[order], turn[order])


def frames(count: int, seed: int = 1) -> EncodedFrames:
    """Return the first ``count`` frames of the bus."""
    bus = Bus.of(count)
    rng = np.random.default_rng(seed)
    data = np.zeros((count, 8), np.uint8)
    for number in range(len(PERIODS_S)):
        rows = np.flatnonzero(bus.number == number)
        data[rows] = _payloads(number, bus.t_s[rows], bus.turn[rows], rng)
    return EncodedFrames(
        t_s=bus.t_s,
        can_id=(FIRST_ID + bus.number).astype(np.uint32),
        length=np.full(count, 8, np.uint8),
        data=data,
    )


def _payloads(number: int, t_s: FloatArray, turn: Int64Array, rng: np.random.Generator) -> UInt8Array:
    """Return the payloads of one message."""
    word = np.zeros(len(turn), np.uint64)
    is_big = number % 2 == 1
    for k, (first, length, *_) in enumerate(places(number)):
        raw = turn % PAGES if is_paged(number) and not k else _raw(number + k, length, t_s, turn, rng)
        page = page_of(number, k)
        shown = raw if page is None else np.where(turn % PAGES == page, raw, 0)
        word |= shown.astype(np.uint64) << np.uint64(64 - first - length if is_big else first)
    return (word.byteswap() if is_big else word).view(np.uint8).reshape(-1, 8)


def _raw(kind: int, length: int, t_s: FloatArray, turn: Int64Array, rng: np.random.Generator) -> Int64Array:
    """Return raw values that behave in one of eight ways, by ``kind``."""
    top = 2**length
    raw: Int64Array
    match kind % 8:
        case 0 | 1:
            raw = np.full(len(turn), kind * 37 % top, np.int64)
        case 2 | 3:
            lasts_s = 3 + kind % 5
            raw = (t_s / lasts_s).astype(np.int64) * 5 % top
        case 4:
            raw = turn % min(top, 16)
        case 5:
            raw = rng.integers(0, top, len(turn))
        case _:
            wave = np.sin(2 * np.pi * SLOW_HZ * (1 + kind % 3) * t_s + kind)
            noisy = (0.5 + 0.4 * wave) * top + rng.normal(0, 0.001 * top, len(turn))
            raw = np.clip(noisy, 0, top - 1).astype(np.int64)
    return raw


def write_log(path: Path, recorded: EncodedFrames) -> Path:
    """Write frames in the format of the path's suffix."""
    with open_log(path) as log:
        for first in range(0, len(recorded.t_s), FRAMES_PER_WRITE):
            log.write(recorded[first : first + FRAMES_PER_WRITE])
    return path


def write_database(path: Path) -> Path:
    """Write the messages as a DBC file."""
    path.write_text(database().as_dbc_string(), encoding="ascii", newline="\n")
    return path
