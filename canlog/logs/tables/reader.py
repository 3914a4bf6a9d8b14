"""Text tables of any layout to batches of frames."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import BinaryIO

import numpy as np

from canlog.arrays import UInt8Array
from canlog.frames import FrameBatch
from canlog.logs.arena import BLOCK_BYTES, MAX_LINE_BYTES, Arena, end_of_line, lines_of
from canlog.logs.tables import kernel
from canlog.logs.tables.kernel import ABSOLUTE, BASE_US, CLOCK_FIELDS, FIELDS, MODE, NOW_US
from canlog.logs.tables.layout import Layout, Role
from canlog.logs.tally import LogReject, Tally
from canlog.logs.text_kernels import LINES, MALFORMED, OTHER, POSITION, ROWS, SKIPPED, STOP, WIDEN

MIN_LINE_BYTES = 8  # "0 R11 1" is the shortest line with a frame
HALF_BYTE_AT_END = re.compile(rb"[^0-9A-Fa-f][0-9A-Fa-f]\n")
HALF_DECIMAL_BYTE_AT_END = re.compile(rb"[^0-9][0-9]{1,2}\n")
LOOK_AHEAD_BYTES = 64 * 1024
TRUSTED_BYTES = 8  # of a format without lengths: a frame with so many is whole


class Clock:
    """What the times of a file are relative to."""

    def __init__(self) -> None:
        self.fields = np.zeros(CLOCK_FIELDS, np.int64)

    def set(self, base_us: int, mode: int = ABSOLUTE, now_us: int = 0) -> None:
        """Count times from ``base_us`` since the epoch; ``now_us`` is the time already passed."""
        self.fields[[BASE_US, MODE, NOW_US]] = base_us, mode, now_us


class Table(ABC):
    """A format: the layout of its lines, which its comments may change, and its clock.

    ``notes`` is what had to be assumed, for people.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.clock = Clock()
        self.notes: list[str] = []

    @abstractmethod
    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""

    def look_ahead(self, text: bytes) -> None:  # noqa: B027 - most formats have nothing to settle
        """Settle what single lines do not tell, from the beginning of the log."""


class TableReader:
    """Reads the text of one file."""

    def __init__(self, table: Table, tally: Tally, rows: int) -> None:
        self._format = table
        self._tally = tally
        self._arena = Arena.of(rows)
        self._line = np.zeros(FIELDS, np.int64)
        self._lines = 0
        self._compile()

    def look_ahead(self, text: UInt8Array) -> None:
        """Let the format look at the beginning of the log."""
        self._format.look_ahead(text[:LOOK_AHEAD_BYTES].tobytes())
        self._compile()

    def parse(self, text: UInt8Array) -> FrameBatch:
        """Return the frames of whole lines; count what is not a frame."""
        report, outcomes, first = (np.zeros(size, np.int64) for size in (4, 3, 3))
        while report[POSITION] < len(text):
            arena = self._arena
            kernel.parse_lines(
                text, self._program, self._vocabulary, self._options, self._is_comment, self._format.clock.fields,
                self._line, arena.t_ns, arena.can_id, arena.length, arena.flags, arena.channel, arena.data,
                report, outcomes, first,
            )  # fmt: skip
            if report[STOP] == WIDEN:
                arena.widen(int(report[ROWS]))
            elif report[STOP] == OTHER:
                end = end_of_line(text, int(report[POSITION]))
                outcome = SKIPPED if self._take(text[report[POSITION] : end].tobytes()) else MALFORMED
                report[POSITION] = end
                report[LINES] += 1
                first[outcome] = first[outcome] if outcomes[outcome] else report[LINES]
                outcomes[outcome] += 1
        self._tally.skipped += int(outcomes[SKIPPED])
        place = f"line {self._lines + int(first[MALFORMED])}"
        self._tally.reject(LogReject.MALFORMED, place, int(outcomes[MALFORMED]))
        self._lines += int(report[LINES])
        for note in self._format.notes:
            self._tally.note(note)
        return self._arena.batch(int(report[ROWS]))

    def parse_last(self, text: UInt8Array) -> FrameBatch:
        """Return the frame of a last line without its end, if no byte of it can be missing."""
        place, tally, self._tally = f"line {self._lines + 1}", self._tally, Tally()
        batch = self.parse(text)
        layout = self._format.layout
        is_halved = layout.has_columns_of_bytes and _half_byte_of(layout).search(text[-4:].tobytes())
        if len(batch) and not is_halved and batch.length[0] >= (1 if layout.tells_length else TRUSTED_BYTES):
            return batch
        if self._tally.skipped and self._is_comment[text[0]]:
            tally.skipped += 1
            return batch
        tally.truncated = True
        tally.reject(LogReject.CUT_OFF, place)
        return batch[:0]

    def _take(self, line: bytes) -> bool:
        layout = self._format.layout
        is_known = self._format.read_comment(line.strip())
        if self._format.layout is not layout:
            self._compile()
        return is_known

    def _compile(self) -> None:
        layout = self._format.layout
        self._program, self._vocabulary = layout.program(), layout.vocabulary()
        self._options = np.array([layout.separator, layout.is_padded], np.int64)
        self._is_comment = np.zeros(256, np.bool_)
        self._is_comment[list(layout.comment_starts)] = True


def reader_of(new_format: Callable[[], Table]) -> Callable[[BinaryIO, Tally], Iterator[FrameBatch]]:
    """Return the function that reads logs of a format."""

    def read(stream: BinaryIO, tally: Tally) -> Iterator[FrameBatch]:
        reader = TableReader(new_format(), tally, (BLOCK_BYTES + MAX_LINE_BYTES) // MIN_LINE_BYTES + 1)
        for number, lines in enumerate(lines_of(stream)):
            if number == 0:
                reader.look_ahead(lines.text)
            batch = reader.parse(lines.text) if lines.is_terminated else reader.parse_last(lines.text)
            if len(batch):
                tally.frames += len(batch)
                yield batch

    return read


def frames_of(table: Table, text: bytes, tally: Tally | None = None) -> FrameBatch:
    """Return the frames of a piece of text, which may be cut anywhere."""
    reader = TableReader(table, tally or Tally(), len(text) // MIN_LINE_BYTES + 2)
    return reader.parse(np.frombuffer(text + b"\n", np.uint8))


def _half_byte_of(layout: Layout) -> re.Pattern[bytes]:
    return HALF_BYTE_AT_END if layout.columns[-1].role is Role.DATA else HALF_DECIMAL_BYTE_AT_END
