"""Ten messages with 64 signals of every kind, and random frames of them in memory."""

from typing import Final

from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

BATCH_FRAMES: Final = 65_536
FIRST_ID: Final = 0x100

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


def message(number: int) -> Message:
    """Return one of the ten messages: every other one is big-endian, the last two are multiplexed."""
    is_big = number % 2 == 1
    if number < 8:
        places = MIXED if number < 4 else MIXED[:6]
        signals = [signal(f"S{k}", place, is_big=is_big) for k, place in enumerate(places)]
    else:
        selector = signal("S0", (0, 2, 1, 0, False), is_big=is_big, is_multiplexer=True)
        pages = [signal(f"S{k + 1}", MIXED[2 + k], is_big=is_big, page=k % 4) for k in range(5)]
        signals = [selector, *pages]
    return Message(FIRST_ID + number, f"M{number}", 8, signals, strict=True)


def database() -> Database:
    """Return the ten messages."""
    return Database([message(number) for number in range(10)])
