"""Logs of lines: one reader for all of them, with a grammar for each format."""

import codecs
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import BinaryIO, cast

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import Frame, FrameBatch, batch_of
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_kernels import (
    FIRST_MALFORMED,
    FRAME,
    LINES,
    MALFORMED,
    MALFORMED_LINES,
    OTHER,
    POSITION,
    PROGRESS_FIELDS,
    ROWS,
    SKIPPED,
    SKIPPED_LINES,
    STOP,
    TOO_LONG,
    FrameBuffer,
    FrameRows,
    count_line,
)

BLOCK_BYTES = 2 * 1024 * 1024
MAX_LINE_BYTES = 4096  # longer lines are no text
LOOK_AHEAD_BYTES = 64 * 1024
BYTE_ORDER_MARK = codecs.BOM_UTF8  # some editors and converters put it before a text


class TextLog(ABC):
    """The grammar of a format, and what is remembered of a file from line to line.

    ``notes`` is what had to be assumed, for people.
    """

    def __init__(self) -> None:
        self.notes: list[str] = []

    @abstractmethod
    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:
        """Return whether no byte can be missing of a last line to which its newline was added."""

    def read_comment(self, line: bytes) -> bool:
        """Read a line without a frame; return whether it belongs to the format."""
        return not line

    def look_ahead(self, text: bytes) -> None:  # noqa: B027 - most formats need not
        """Find out from the beginning of the log what single lines do not show."""


class KernelLog(TextLog):
    """A format whose lines a compiled reader goes through."""

    shortest_line_bytes: int  # of all with a frame, its newline included

    @abstractmethod
    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines from the position in ``progress`` until one stops the compiled reader; write why into it."""


class LineLog(TextLog):
    """A format whose lines are read one by one."""

    @abstractmethod
    def read_line(self, line: bytes) -> Frame | int:
        """Return the frame of a line, or what else it is: SKIPPED, MALFORMED, or OTHER, for ``read_comment``."""


class TextReader:
    """Reads the text of one file, which comes in blocks of no more than so many bytes."""

    def __init__(self, log: TextLog, counts: LogCounts, block_bytes: int) -> None:
        self._log = log
        self._counts = counts
        self._buffer = FrameBuffer(block_bytes // log.shortest_line_bytes + 1 if isinstance(log, KernelLog) else 0)
        self._lines = 0
        self._comments = 0

    def read(self, text: UInt8Array) -> FrameBatch:
        """Return the frames of whole lines; count what is not a frame."""
        if isinstance(self._log, KernelLog):
            return self._read_by_kernel(self._log, text)
        return self._read_lines(cast("LineLog", self._log), text)

    def read_last(self, text: UInt8Array) -> FrameBatch:
        """Return the frame of a last line without its end, if no byte of it can be missing."""
        counts, self._counts, comments = self._counts, LogCounts(), self._comments
        frame = self.read(text)
        if len(frame) and self._log.is_whole(text.tobytes(), frame):
            return frame
        if self._comments > comments:
            counts.skipped += 1
        else:
            counts.cut_off(f"line {self._lines}")
        return frame[:0]

    def _read_lines(self, log: LineLog, text: UInt8Array) -> FrameBatch:
        frames = list[Frame]()
        for line in text.tobytes().split(b"\n")[:-1]:
            self._lines += 1
            outcome = log.read_line(line)
            if isinstance(outcome, Frame):
                frames.append(outcome)
            elif outcome == SKIPPED or (outcome == OTHER and self._comment(line) == SKIPPED):
                self._counts.skipped += 1
            else:
                self._counts.reject(LogReject.MALFORMED, f"line {self._lines}")
        return batch_of(frames)

    def _read_by_kernel(self, log: KernelLog, text: UInt8Array) -> FrameBatch:
        progress = np.zeros(PROGRESS_FIELDS, np.int64)
        while progress[POSITION] < len(text):
            progress[STOP] = FRAME
            log.parse(text, self._buffer.rows, progress)
            if progress[STOP] == TOO_LONG:
                self._buffer.widen(int(progress[ROWS]))
            elif progress[STOP] == OTHER:
                start = int(progress[POSITION])
                progress[POSITION] = end_of_line(text, start)
                progress[LINES] += 1
                count_line(progress, self._comment(text[start : progress[POSITION]].tobytes()), progress[LINES])
        self._counts.skipped += int(progress[SKIPPED_LINES])
        place = f"line {self._lines + int(progress[FIRST_MALFORMED])}"
        self._counts.reject(LogReject.MALFORMED, place, int(progress[MALFORMED_LINES]))
        self._lines += int(progress[LINES])
        return self._buffer.batch(int(progress[ROWS]))

    def _comment(self, line: bytes) -> int:
        is_known = self._log.read_comment(line.strip())
        self._comments += is_known
        return SKIPPED if is_known else MALFORMED


def reader_of(new_log: Callable[[], TextLog]) -> Callable[[BinaryIO, LogCounts], Iterator[FrameBatch]]:
    """Return the function that reads logs of a format: a batch for each 2 MiB of text."""

    def read(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
        log = new_log()
        reader = TextReader(log, counts, BLOCK_BYTES + MAX_LINE_BYTES)
        looks_ahead = type(log).look_ahead is not TextLog.look_ahead
        least_bytes = LOOK_AHEAD_BYTES + MAX_LINE_BYTES if looks_ahead else len(BYTE_ORDER_MARK)
        for number, (text, is_terminated) in enumerate(lines_of(stream, least_bytes)):
            if number == 0:
                log.look_ahead(text[:LOOK_AHEAD_BYTES].tobytes())
            batch = reader.read(text) if is_terminated else reader.read_last(text)
            for note in log.notes:
                counts.note(note)
            if len(batch):
                counts.frames += len(batch)
                yield batch

    return read


def frames_of(log: TextLog, text: bytes, counts: LogCounts | None = None) -> FrameBatch:
    """Return the frames of a piece of text, which may be cut anywhere."""
    reader = TextReader(log, counts or LogCounts(), len(text) + 1)
    return reader.read(np.frombuffer(text + b"\n", np.uint8))


def lines_of(stream: BinaryIO, least_bytes: int = len(BYTE_ORDER_MARK)) -> Iterator[tuple[UInt8Array, bool]]:
    """Yield a text in blocks of whole lines, about 2 MiB each, and last what follows the last newline.

    Beside each block stands whether its last newline is the file's own: one is added to a line that the file may have
    cut. A block is valid until the next one is asked for. A byte-order mark before the first line is passed over. Of a
    line that is too long to be one only the end is passed on, behind a NUL that makes it malformed. A live stream has
    smaller blocks, as they come; the first reading of it takes ``least_bytes``. Lines that end with a carriage return
    alone are lines, too, if those at the beginning do.
    """
    buffer = bytearray(BLOCK_BYTES + MAX_LINE_BYTES)
    kept_bytes, is_first, has_returns = 0, True, False
    while got := _fill(stream, memoryview(buffer)[kept_bytes:], least_bytes if is_first else 1):
        stop = kept_bytes + got
        if is_first and buffer.startswith(BYTE_ORDER_MARK):
            stop -= len(BYTE_ORDER_MARK)
            buffer[:stop] = buffer[len(BYTE_ORDER_MARK) : stop + len(BYTE_ORDER_MARK)]
        has_returns = ends_by_returns(buffer[: min(stop, LOOK_AHEAD_BYTES)]) if is_first else has_returns
        if has_returns:
            buffer[kept_bytes:stop] = buffer[kept_bytes:stop].replace(b"\r", b"\n")
        is_first = False
        end = buffer.rfind(b"\n", kept_bytes, stop) + 1
        if end:
            yield np.frombuffer(memoryview(buffer).toreadonly(), np.uint8, end), True
        rest = buffer[end:stop]
        if len(rest) > MAX_LINE_BYTES:
            rest = bytearray(b"\0")
        kept_bytes = len(rest)
        buffer[:kept_bytes] = rest
    if buffer[:kept_bytes].strip():
        yield np.frombuffer(bytes(buffer[:kept_bytes]) + b"\n", np.uint8), False


def ends_by_returns(beginning: bytes | bytearray) -> bool:
    """Return whether most lines of a text end with a carriage return that no newline follows."""
    return beginning.count(b"\r") - beginning.count(b"\r\n") > beginning.count(b"\n")


def end_of_line(text: UInt8Array, at: int) -> int:
    """Return the position behind the newline that ends a line."""
    step = 128
    while (offset := text[at : at + step].tobytes().find(b"\n")) < 0:
        at, step = at + step, MAX_LINE_BYTES
    return at + offset + 1


def _fill(stream: BinaryIO, view: memoryview, least_bytes: int) -> int:
    """Read until the view is full, or of a live stream as much as there is; return how much, 0 at the end.

    A stream may come in small pieces.
    """
    enough_bytes = least_bytes if getattr(stream, "is_live", False) else len(view)
    count = 0
    while count < enough_bytes and (got := stream.readinto(view[count:])):  # type: ignore[attr-defined]  # of every one
        count += got
    return count
