"""candump logs (``candump -l``): ``(1767225600.000000) vcan0 0A0#1122334455667788``, FD frames with ``##``, to columns.

Times keep the whole microseconds that candump writes; further digits are cut off. Lines that do not follow the grammar
are counted with the number of the first one, and reading goes on.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch
from canlog.logs.arena import BLOCK_BYTES, MAX_LINE_BYTES, Arena, lines_of
from canlog.logs.candump_kernel import parse_lines
from canlog.logs.channels import ChannelNames
from canlog.logs.tally import LogReject, Tally
from canlog.logs.text_kernels import LINES, MALFORMED, NEW_CHANNEL, POSITION, ROWS, SKIPPED, STOP, WIDEN

MIN_LINE_BYTES = 10  # "(0.0) c 1#" is the shortest line with a frame


def read_candump(stream: BinaryIO, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frames of a candump log, one batch for each 2 MiB of text."""
    parser = _Parser(tally)
    for lines in lines_of(stream):
        batch = parser.parse(lines.text) if lines.is_terminated else parser.parse_last(lines.text)
        if len(batch):
            tally.frames += len(batch)
            yield batch


def frames_in_candump(text: bytes) -> int:
    """Return how many lines of a piece of text hold a frame in candump's grammar."""
    return len(_Parser(Tally()).parse(np.frombuffer(text + b"\n", np.uint8)))


@dataclass(slots=True)
class _Parser:
    """What is remembered from block to block."""

    tally: Tally
    arena: Arena = field(default_factory=lambda: Arena.of((BLOCK_BYTES + MAX_LINE_BYTES) // MIN_LINE_BYTES + 1))
    channels: ChannelNames = field(default_factory=ChannelNames)
    lines: int = 0
    report: Int64Array = field(default_factory=lambda: np.zeros(4, np.int64))
    outcomes: Int64Array = field(default_factory=lambda: np.zeros(3, np.int64))
    first: Int64Array = field(default_factory=lambda: np.zeros(3, np.int64))

    def parse(self, text: UInt8Array) -> FrameBatch:
        """Return the frames of whole lines; count what is not a frame."""
        arena, channels = self.arena, self.channels
        self.report[:] = 0
        self.outcomes[:] = 0
        while self.report[POSITION] < len(text):
            parse_lines(
                text, arena.t_ns, arena.can_id, arena.length, arena.flags, arena.channel, arena.data, arena.data_words,
                channels.words, len(channels), self.report, self.outcomes, self.first,
            )  # fmt: skip
            if self.report[STOP] == WIDEN:
                arena.widen(int(self.report[ROWS]))
            elif self.report[STOP] == NEW_CHANNEL:
                channels.add(_channel_name(text, int(self.report[POSITION])))
        self.tally.skipped += int(self.outcomes[SKIPPED])
        place = f"line {self.lines + int(self.first[MALFORMED])}"
        self.tally.reject(LogReject.MALFORMED, place, int(self.outcomes[MALFORMED]))
        self.lines += int(self.report[LINES])
        return arena.batch(int(self.report[ROWS]))

    def parse_last(self, text: UInt8Array) -> FrameBatch:
        """Return the frame of a last line without its end, if no byte of it can be missing."""
        place, tally, self.tally = f"line {self.lines + 1}", self.tally, Tally()
        batch = self.parse(text)
        if len(batch) and batch.length[0] in {PAYLOAD_BYTES, FD_PAYLOAD_BYTES}:
            return batch
        tally.truncated = True
        tally.reject(LogReject.CUT_OFF, place)
        return batch[:0]


def _channel_name(text: UInt8Array, line: int) -> bytes:
    """Return the interface's name in a line that holds a frame."""
    return text[line : line + MAX_LINE_BYTES].tobytes().partition(b")")[2].split(maxsplit=1)[0]
