"""candump logs (``candump -l``): ``(1767225600.000000) vcan0 0A0#1122334455667788``, FD frames with ``##``, to columns.

Times keep the whole microseconds that candump writes; further digits are cut off. Lines that do not follow the grammar
are counted with the number of the first one, and reading goes on.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from clutch_model.jit import array_kernel
from diag_service.frames import EXTENDED_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch
from diag_service.records import Int64Array, UInt8Array, UInt32Array
from diag_service.sources.arena import BLOCK_BYTES, MAX_LINE_BYTES, Arena, lines_of
from diag_service.sources.channels import ChannelNames
from diag_service.sources.tally import LogReject, Tally
from diag_service.sources.text_kernels import (
    AT_END,
    BLANK,
    DECIMAL_PAIR,
    FRAME,
    HEX_VALUE,
    IS_LENGTH,
    LINES,
    MALFORMED,
    NEW_CHANNEL,
    NEWLINE,
    POSITION,
    ROWS,
    SKIPPED,
    STOP,
    WIDEN,
    count_lines,
    eight_hex_bytes,
    hex_bytes,
    skip_blanks,
    skip_line,
)

MIN_LINE_BYTES = 10  # "(0.0) c 1#" is the shortest line with a frame
STANDARD_DIGITS = 3
EXTENDED_DIGITS = 8
ERROR_OR_ABOVE = 0x2000_0000  # written with eight digits, yet not an extended identifier
MAX_ID = 0x3FFF_FFFF
MAX_SECONDS_DIGITS = 10
NS_DIGITS = 9
NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
FD_DIGIT_BITS = 0x03  # of the digit behind "##": bit rate switch and error state, as in ``flags``

USUAL_TIME_BYTES = 19  # "(1767225600.000000)"

# Characters of the grammar.
OPEN, CLOSE, POINT, HASH, UNDERSCORE = 40, 41, 46, 35, 95


def read_candump(stream: BinaryIO, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frames of a candump log, one batch for each 2 MiB of text."""
    parser = _Parser(tally)
    for lines in lines_of(stream):
        batch = parser.parse(lines.text) if lines.is_terminated else parser.parse_last(lines.text)
        if len(batch):
            tally.frames += len(batch)
            yield batch


def holds_candump(text: bytes) -> bool:
    """Return whether any line of a piece of text holds a frame in candump's grammar."""
    return len(_Parser(Tally()).parse(np.frombuffer(text + b"\n", np.uint8))) > 0


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
            _parse_lines(
                text, arena.t_ns, arena.can_id, arena.length, arena.flags, arena.channel, arena.data,
                channels.hashes, channels.numbers, len(channels), self.report, self.outcomes, self.first,
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


@array_kernel
def _parse_lines(
    text: UInt8Array,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
    hashes: Int64Array,
    numbers: UInt8Array,
    known: int,
    report: Int64Array,
    outcomes: Int64Array,
    first: Int64Array,
) -> None:
    """Parse lines from where the report says; stop where the caller has to do something, else at the end."""
    at, line, row = report[POSITION], report[LINES], report[ROWS]
    last_hash, last_number = 0, np.uint8(0)
    report[STOP] = AT_END
    while at < len(text):
        outcome, end, name = _parse_line(text, at, row, t_ns, can_id, length, flags, data)
        if outcome == WIDEN_FIRST:
            report[STOP] = WIDEN
            break
        if outcome == FRAME:
            if name != last_hash:
                number = _channel_number(name, hashes, numbers, known)
                if number < 0:
                    report[STOP] = NEW_CHANNEL
                    break
                last_hash, last_number = name, np.uint8(number)
            channel[row] = last_number
            row += 1
        line += 1
        count_lines(outcomes, first, outcome, line)
        at = end
    report[POSITION], report[LINES], report[ROWS] = at, line, row


WIDEN_FIRST = 3  # beside the outcomes: a frame that does not fit into the arena


@array_kernel
def _parse_line(
    text: UInt8Array,
    at: int,
    row: int,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    data: UInt8Array,
) -> tuple[int, int, int]:
    """Parse one line into one row; return outcome, position behind the line and a number for the channel's name."""
    at = skip_blanks(text, at)
    if text[at] == NEWLINE:
        return SKIPPED, at + 1, 0
    time, at = _time_ns(text, at)
    if time < 0:
        return MALFORMED, skip_line(text, at), 0
    at = skip_blanks(text, at)
    name = NAME_SEED
    begin = at
    while text[at] > BLANK:
        name = (name ^ text[at]) * NAME_FACTOR
        at += 1
    identifier, at = _parse_id(text, skip_blanks(text, at))
    if identifier < 0 or begin == at:
        return MALFORMED, skip_line(text, at), 0
    t_ns[row] = time
    can_id[row] = identifier
    flags[row] = 0
    if text[at] == HASH:
        if data.shape[1] < FD_PAYLOAD_BYTES:
            return WIDEN_FIRST, at, 0
        at = _parse_fd_payload(text, at + 1, row, length, flags, data)
    elif text[at] == 82 or text[at] == 114:  # R or r
        at = _parse_remote(text, at + 1, row, can_id, length, data)
    else:
        count, at = _payload(text, at, row, data, PAYLOAD_BYTES)
        length[row] = count
    if at >= 0:
        at = _parse_tail(text, at)
    if at < 0:
        return MALFORMED, skip_line(text, -at), 0
    return FRAME, at, name


NAME_SEED, NAME_FACTOR = -3750763034362895579, 1099511628211  # FNV-1a, 64 bits


@array_kernel
def _channel_number(name: int, hashes: Int64Array, numbers: UInt8Array, known: int) -> int:
    """Return the number of a channel's name, -1 if it is new."""
    for index in range(known):
        if hashes[index] == name:
            return int(numbers[index])
    return -1


@array_kernel
def _time_ns(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse a time in brackets; return it, -1 if it is none, and the position behind it."""
    time, behind = _usual_time(text, at)
    return (time, behind) if time >= 0 else _parse_time(text, at)


@array_kernel
def _usual_time(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``(1767225600.000000)``, its digits in independent pairs; -1 if any of it stands elsewhere."""
    if at + USUAL_TIME_BYTES > len(text) or text[at] != OPEN or text[at + 11] != POINT or text[at + 18] != CLOSE:
        return -1, at
    a, b = DECIMAL_PAIR[text[at + 1], text[at + 2]], DECIMAL_PAIR[text[at + 3], text[at + 4]]
    c, d = DECIMAL_PAIR[text[at + 5], text[at + 6]], DECIMAL_PAIR[text[at + 7], text[at + 8]]
    e, f = DECIMAL_PAIR[text[at + 9], text[at + 10]], DECIMAL_PAIR[text[at + 12], text[at + 13]]
    g, h = DECIMAL_PAIR[text[at + 14], text[at + 15]], DECIMAL_PAIR[text[at + 16], text[at + 17]]
    if a | b | c | d | e | f | g | h < 0:
        return -1, at
    seconds = a * 100_000_000 + b * 1_000_000 + c * 10_000 + d * 100 + e
    return seconds * NS_PER_S + (f * 10_000 + g * 100 + h) * NS_PER_US, at + USUAL_TIME_BYTES


@array_kernel
def _parse_time(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``(seconds.fraction)``; return the time [ns], -1 if it is none, and the position behind it."""
    if text[at] != OPEN:
        return -1, at
    at += 1
    begin = at
    seconds = 0
    while 48 <= text[at] <= 57 and at - begin < MAX_SECONDS_DIGITS:
        seconds = seconds * 10 + text[at] - 48
        at += 1
    if at == begin or text[at] != POINT:
        return -1, at
    at += 1
    begin = at
    fraction = 0
    weight = NS_PER_S
    while 48 <= text[at] <= 57 and at - begin < NS_DIGITS:
        weight //= 10
        fraction += weight * (text[at] - 48)
        at += 1
    if at == begin or text[at] != CLOSE:
        return -1, at
    return seconds * NS_PER_S + fraction // NS_PER_US * NS_PER_US, at + 1


@array_kernel
def _parse_id(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``123#`` or ``12345678#``; return the identifier with its flags, -1 if it is none, and the position."""
    begin = at
    value = 0
    while HEX_VALUE[text[at]] >= 0 and at - begin < EXTENDED_DIGITS:
        value = value * 16 + HEX_VALUE[text[at]]
        at += 1
    digits = at - begin
    if text[at] != HASH or value > MAX_ID:
        return -1, at
    if digits == EXTENDED_DIGITS:
        return (value | EXTENDED_FLAG if value < ERROR_OR_ABOVE else value), at + 1
    if digits == STANDARD_DIGITS and value <= 0x7FF:
        return value, at + 1
    return -1, at


@array_kernel
def _payload(text: UInt8Array, at: int, row: int, data: UInt8Array, limit: int) -> tuple[int, int]:
    """Parse ``1122`` or ``11.22`` into a row that is zero behind it; return the count and the position."""
    end = at + 2 * PAYLOAD_BYTES
    is_usual = end < len(text) and text[end] <= BLANK and data.shape[1] == PAYLOAD_BYTES
    if is_usual and eight_hex_bytes(text, at, row, data):
        return PAYLOAD_BYTES, end
    count, at = hex_bytes(text, at, row, data, limit, POINT)
    for index in range(count, data.shape[1]):
        data[row, index] = 0
    return count, at


@array_kernel
def _parse_fd_payload(
    text: UInt8Array, at: int, row: int, length: UInt8Array, flags: UInt8Array, data: UInt8Array
) -> int:
    """Parse flags and payload of an FD frame; return the position, negative if it is none."""
    digit = HEX_VALUE[text[at]]
    if digit < 0:
        return -at
    count, at = _payload(text, at + 1, row, data, FD_PAYLOAD_BYTES)
    flags[row] = FD_FLAG | (digit & FD_DIGIT_BITS)
    length[row] = count
    return at if IS_LENGTH[count] else -at


@array_kernel
def _parse_remote(
    text: UInt8Array, at: int, row: int, can_id: UInt32Array, length: UInt8Array, data: UInt8Array
) -> int:
    """Parse what follows the ``R`` of a remote frame; return the position, negative if it is none."""
    data[row, :] = 0
    can_id[row] |= np.uint32(REMOTE_FLAG)
    length[row] = 0
    if 48 <= text[at] <= 57:
        length[row] = text[at] - 48
        at += 1
    return at if length[row] <= PAYLOAD_BYTES else -at


@array_kernel
def _parse_tail(text: UInt8Array, at: int) -> int:
    """Pass over what may follow a payload; return the position behind the line, negative if it is anything else."""
    if text[at] == UNDERSCORE and HEX_VALUE[text[at + 1]] > PAYLOAD_BYTES:
        at += 2  # the raw length code above eight that some controllers send
    behind = skip_blanks(text, at)
    if behind > at and (text[behind] == 82 or text[behind] == 84):  # the direction, R or T, that candump -x appends
        behind = skip_blanks(text, behind + 1)
    return behind + 1 if text[behind] == NEWLINE else -behind
