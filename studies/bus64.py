"""A made-up bus for speed measurements: ten messages, 64 signals of every kind, as a DBC and as logs."""

from collections.abc import Iterator
from pathlib import Path

import cantools
import numpy as np
from cantools.database.can import Database

from canlog.arrays import FloatArray
from canlog.decode.codec import Codec
from canlog.frames import FrameBatch
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.record import open_log

FRAME_PERIOD_S = 0.00025
FIRST_ID, MESSAGE_COUNT, MULTIPLEXED_COUNT = 0x100, 10, 2
FRAMES_PER_WRITE = 100_000
PLAIN_SIGNALS = ("0|12@1+", "12|10@1-", "22|10@1+", "39|16@0+", "55|8@0-", "63|8@0+")
MULTIPLEXED_SIGNALS = {0: ("8|16@1+", "24|16@1-", "47|16@0+"), 1: ("8|8@1+", "16|12@1-", "39|16@0+", "55|16@0-")}


def dbc_text() -> str:
    """Return the database: plain messages, then multiplexed ones."""
    lines = ['VERSION ""', "BU_: A"]
    for number in range(MESSAGE_COUNT):
        lines.append(f"BO_ {FIRST_ID + number} M{number}: 8 A")
        if number < MESSAGE_COUNT - MULTIPLEXED_COUNT:
            lines += [_signal(f"S{number}_{k}", "", bits, k) for k, bits in enumerate(PLAIN_SIGNALS)]
            continue
        lines.append(_signal(f"S{number}_M", "M ", "0|1@1+", 0, factor=1.0))
        for value, signals in MULTIPLEXED_SIGNALS.items():
            lines += [_signal(f"S{number}_{value}{k}", f"m{value} ", bits, k) for k, bits in enumerate(signals)]
    return "\n".join(lines) + "\n"


def _signal(name: str, multiplex: str, bits: str, number: int, factor: float | None = None) -> str:
    factor = (0.25, 0.1, 2.0, 0.5)[number % 4] if factor is None else factor
    return f' SG_ {name} {multiplex}: {bits} ({factor},{-40 * (number % 2)}) [0|0] "" A'


def load_bus() -> Database:
    """Return the database as cantools holds it."""
    database = cantools.database.load_string(dbc_text(), "dbc")
    assert isinstance(database, Database)  # noqa: S101 - for the type checker
    return database


def frames(count: int) -> EncodedFrames:
    """Return frames of all messages in turn, with values that move slowly, as a vehicle's do."""
    turn = np.arange(count, dtype=np.int64)
    cycle = turn // MESSAGE_COUNT
    data = np.empty((count, 8), np.uint8)
    for byte in range(8):
        data[:, byte] = (cycle * (1 + byte) // (4 << (byte % 4)) + turn % MESSAGE_COUNT * 17) & 0xFF
    return EncodedFrames(
        t_s=(turn * FRAME_PERIOD_S).astype(np.float64),
        can_id=(FIRST_ID + turn % MESSAGE_COUNT).astype(np.uint32),
        length=np.full(count, 8, np.uint8),
        data=data,
    )


def write_log(path: Path, count: int) -> Path:
    """Write so many frames in the format of the path's suffix."""
    recorded = frames(count)
    with open_log(path) as log:
        for first in range(0, count, FRAMES_PER_WRITE):
            log.write(recorded[first : first + FRAMES_PER_WRITE])
    return path


class Decoder:
    """All signals of the bus, by the service's compiled tables."""

    def __init__(self) -> None:
        self._codec = Codec(load_bus().messages, check_range=False)

    def decode(self, batch: FrameBatch) -> Iterator[FloatArray]:
        """Yield the values of one signal after the other."""
        for message in self._codec.decode(batch):
            yield from (decoded.value for decoded in message.signals.values())
