"""candump logs (``candump -l``): ``(1767225600.000000) vcan0 0A0#1122334455667788`` to columns.

Times keep the whole microseconds that candump writes; further digits are cut off. Lines that do not follow the grammar
are counted with the number of the first one, and reading goes on.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from clutch_model.jit import kernel
from diag_service.frames import EXTENDED_FLAG, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch
from diag_service.records import Int64Array, UInt8Array, UInt32Array
from diag_service.sources.tally import LogReject, Tally

BLOCK_BYTES = 2 * 1024 * 1024
MIN_LINE_BYTES = 10  # "(0.0) c 1#" is the shortest line with a frame
MAX_LINE_BYTES = 4096  # whatever is longer is not text
STANDARD_DIGITS = 3
EXTENDED_DIGITS = 8
ERROR_OR_ABOVE = 0x2000_0000  # written with eight digits, yet not an extended identifier
MAX_ID = 0x3FFF_FFFF
MAX_SECONDS_DIGITS = 10
NS_DIGITS = 9
NS_PER_S = 1_000_000_000
NS_PER_US = 1_000

# Outcomes of one line, in the order of the kernel's counters.
FRAME, BLANK, MALFORMED, CAN_FD = range(4)


@dataclass(slots=True, kw_only=True)
class _Arena:
    """Arrays the kernel fills, reused for every block."""

    t_ns: Int64Array
    can_id: UInt32Array
    length: UInt8Array
    data: UInt8Array
    outcomes: Int64Array  # lines by outcome, in this block
    first: Int64Array  # number of the first line with that outcome, in this block


def read_candump(stream: BinaryIO, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frames of a candump log, one batch for each 2 MiB of text."""
    arena = _new_arena()
    rest, lines = b"", 0
    while block := stream.read(BLOCK_BYTES):
        whole, newline, tail = (rest + block).rpartition(b"\n")
        if not newline and len(tail) > MAX_LINE_BYTES:
            tally.reject(LogReject.MALFORMED, f"line {lines + 1}")
            tail = tail[-MAX_LINE_BYTES:]
        rest = tail
        if newline:
            yield from _parse(whole + newline, lines, arena, tally)
            lines += whole.count(b"\n") + 1
    if rest.strip():
        yield from _parse_last(rest, lines, arena, tally)


def holds_candump(text: bytes) -> bool:
    """Return whether any line of a piece of text holds a frame in candump's grammar."""
    arena = _new_arena(len(text) // MIN_LINE_BYTES + 2)
    tally = Tally()
    batches = list(_parse(text + b"\n", 0, arena, tally))
    return bool(batches) or LogReject.CAN_FD in tally.snapshot().rejected


def _parse(text: bytes, lines_before: int, arena: _Arena, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frames of whole lines as one batch; count what is not a frame."""
    _parse_lines(
        np.frombuffer(text, np.uint8), len(text), arena.t_ns, arena.can_id, arena.length, arena.data, arena.outcomes,
        arena.first,
    )  # fmt: skip
    tally.skipped += int(arena.outcomes[BLANK])
    for outcome, reason in ((MALFORMED, LogReject.MALFORMED), (CAN_FD, LogReject.CAN_FD)):
        place = f"line {lines_before + int(arena.first[outcome])}"
        tally.reject(reason, place, int(arena.outcomes[outcome]))
    count = int(arena.outcomes[FRAME])
    if count:
        tally.frames += count
        yield FrameBatch(
            t_ns=arena.t_ns[:count].copy(),
            can_id=arena.can_id[:count].copy(),
            length=arena.length[:count].copy(),
            data=arena.data[:count].copy(),
        )


def _parse_last(line: bytes, lines_before: int, arena: _Arena, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frame of a last line without its end, if no byte of it can be missing."""
    probe = Tally()
    batches = list(_parse(line + b"\n", lines_before, arena, probe))
    if batches and batches[0].length[0] == PAYLOAD_BYTES:
        tally.frames += 1
        yield batches[0]
    else:
        tally.truncated = True
        tally.reject(LogReject.CUT_OFF, f"line {lines_before + 1}")


def _new_arena(lines: int = (BLOCK_BYTES + MAX_LINE_BYTES) // MIN_LINE_BYTES + 1) -> _Arena:
    return _Arena(
        t_ns=np.empty(lines, np.int64),
        can_id=np.empty(lines, np.uint32),
        length=np.empty(lines, np.uint8),
        data=np.empty((lines, PAYLOAD_BYTES), np.uint8),
        outcomes=np.zeros(4, np.int64),
        first=np.zeros(4, np.int64),
    )


@kernel
def _parse_lines(
    text: UInt8Array,
    stop: int,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    data: UInt8Array,
    outcomes: Int64Array,
    first: Int64Array,
) -> None:
    """Parse lines that end with a newline; frames go to the columns, outcomes are counted by kind."""
    outcomes[:] = 0
    first[:] = 0
    row = 0
    line = 0
    start = 0
    while start < stop:
        end = start
        while text[end] != 10:
            end += 1
        line += 1
        outcome = _parse_line(text, start, end, row, t_ns, can_id, length, data)
        if outcome == FRAME:
            row += 1
        if outcomes[outcome] == 0:
            first[outcome] = line
        outcomes[outcome] += 1
        start = end + 1


@kernel
def _parse_line(
    text: UInt8Array,
    start: int,
    stop: int,
    row: int,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    data: UInt8Array,
) -> int:
    """Parse one line into one row and return the outcome; a row that is not a FRAME holds garbage."""
    at = _skip_blanks(text, start, stop)
    while stop > at and (text[stop - 1] == 32 or text[stop - 1] == 9 or text[stop - 1] == 13):
        stop -= 1
    if at == stop:
        return BLANK
    if stop - at > 2 and text[stop - 2] == 32 and (text[stop - 1] == 82 or text[stop - 1] == 84):
        stop -= 2  # the direction, R or T, that candump -x and python-can append
    at = _parse_time(text, at, stop, row, t_ns)
    if at < 0:
        return MALFORMED
    channel = _skip_blanks(text, at, stop)
    at = channel
    while at < stop and text[at] != 32 and text[at] != 9:
        at += 1
    if channel == at:
        return MALFORMED
    at = _parse_id(text, _skip_blanks(text, at, stop), stop, row, can_id)
    if at < 0:
        return MALFORMED
    if at < stop and text[at] == 35:  # a second "#"
        return CAN_FD
    return _parse_payload(text, at, stop, row, can_id, length, data)


@kernel
def _parse_time(text: UInt8Array, at: int, stop: int, row: int, t_ns: Int64Array) -> int:
    """Parse ``(seconds.fraction)``; return the position behind it or -1."""
    if at >= stop or text[at] != 40:
        return -1
    at += 1
    begin = at
    seconds = np.int64(0)
    while at < stop and 48 <= text[at] <= 57:
        seconds = seconds * 10 + (np.int64(text[at]) - 48)
        at += 1
    if at == begin or at - begin > MAX_SECONDS_DIGITS or at >= stop or text[at] != 46:
        return -1
    at += 1
    begin = at
    fraction = np.int64(0)
    weight = NS_PER_S
    while at < stop and 48 <= text[at] <= 57:
        weight //= 10
        fraction += weight * (np.int64(text[at]) - 48)
        at += 1
    if at == begin or at - begin > NS_DIGITS or at >= stop or text[at] != 41:
        return -1
    t_ns[row] = seconds * NS_PER_S + fraction // NS_PER_US * NS_PER_US
    return at + 1


@kernel
def _parse_id(text: UInt8Array, at: int, stop: int, row: int, can_id: UInt32Array) -> int:
    """Parse ``123#`` or ``12345678#``; return the position behind the sign or -1."""
    begin = at
    value = np.int64(0)
    while at < stop and at - begin <= EXTENDED_DIGITS and _hex_digit(text[at]) >= 0:
        value = value * 16 + _hex_digit(text[at])
        at += 1
    digits = at - begin
    if at >= stop or text[at] != 35 or value > MAX_ID or digits not in (STANDARD_DIGITS, EXTENDED_DIGITS):
        return -1
    if digits == STANDARD_DIGITS and value > 0x7FF:
        return -1
    if digits == EXTENDED_DIGITS and value < ERROR_OR_ABOVE:
        value |= EXTENDED_FLAG
    can_id[row] = value
    return at + 1


@kernel
def _parse_payload(
    text: UInt8Array, at: int, stop: int, row: int, can_id: UInt32Array, length: UInt8Array, data: UInt8Array
) -> int:
    """Parse ``1122``, ``11.22``, ``R`` or ``R4``, with or without ``_DLC``; return the outcome."""
    data[row, :] = 0
    if stop - at > 2 and text[stop - 2] == 95 and _hex_digit(text[stop - 1]) > PAYLOAD_BYTES:
        stop -= 2  # the raw length code above eight that some controllers send
    if at < stop and (text[at] == 82 or text[at] == 114):
        dlc = np.int64(0)
        if at + 2 == stop and 48 <= text[at + 1] <= 56:
            dlc = np.int64(text[at + 1]) - 48
        elif at + 1 != stop:
            return MALFORMED
        can_id[row] |= np.uint32(REMOTE_FLAG)
        length[row] = dlc
        return FRAME
    count = 0
    while at + 1 < stop and count < PAYLOAD_BYTES:
        high = _hex_digit(text[at])
        low = _hex_digit(text[at + 1])
        if high < 0 or low < 0:
            return MALFORMED
        data[row, count] = high * 16 + low
        count += 1
        at += 2
        if at + 1 < stop and text[at] == 46:
            at += 1
    if at != stop:
        return MALFORMED
    length[row] = count
    return FRAME


@kernel
def _skip_blanks(text: UInt8Array, at: int, stop: int) -> int:
    """Return the position of the next character that is neither space nor tabulator."""
    while at < stop and (text[at] == 32 or text[at] == 9):
        at += 1
    return at


@kernel
def _hex_digit(character: np.uint8) -> np.int64:
    """Return the value of a hexadecimal digit, -1 for any other character."""
    if 48 <= character <= 57:
        return np.int64(character) - 48
    if 65 <= character <= 70:
        return np.int64(character) - 55
    if 97 <= character <= 102:
        return np.int64(character) - 87
    return np.int64(-1)
