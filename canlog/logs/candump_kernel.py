"""The lines of a candump log, compiled: usual ones eight characters at a time, all others one by one."""

import numpy as np

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import EXTENDED_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, REMOTE_FLAG, TX_FLAG
from canlog.jit import array_kernel
from canlog.logs.candump_usual import (
    CLOSE,
    ERROR_OR_ABOVE,
    EXTENDED_DIGITS,
    HASH,
    LONGEST_USUAL_BYTES,
    NS_PER_S,
    NS_PER_US,
    OPEN,
    POINT,
    STANDARD_DIGITS,
    usual_line,
)
from canlog.logs.channels import NameWords
from canlog.logs.text_kernels import (
    AT_END,
    BLANK,
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
    decimal,
    decimal_parts,
    hex_bytes,
    hexadecimal,
    skip_blanks,
    skip_line,
)
from canlog.logs.word_kernels import UInt64Array

MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x3FFF_FFFF
MAX_SECONDS_DIGITS = 10
NS_DIGITS = 9
FD_DIGIT_BITS = 0x03  # of the digit behind "##": bit rate switch and error state, as in ``flags``

WIDEN_FIRST = 3  # beside the outcomes: a frame that does not fit into the arena
NAME_SEED, NAME_FACTOR = -3750763034362895579, 1099511628211  # FNV-1a, 64 bits

UNDERSCORE = 95


@array_kernel
def parse_lines(
    text: UInt8Array,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
    data_words: UInt64Array,
    names: NameWords,
    known: int,
    report: Int64Array,
    outcomes: Int64Array,
    first: Int64Array,
) -> None:
    """Parse lines from where the report says; stop where the caller has to do something, else at the end.

    ``data_words`` are the payloads of ``data`` as words of eight bytes.
    """
    at, line, row, index = report[POSITION], report[LINES], report[ROWS], 0
    report[STOP] = AT_END
    while at < len(text):
        if at + LONGEST_USUAL_BYTES <= len(text) and known > 0:
            index, behind = usual_line(
                text, at, row, t_ns, can_id, length, flags, channel, data, data_words, names, index, known
            )
            if behind >= 0:
                row += 1
                line += 1
                at = behind
                continue
        outcome, end, name = _parse_line(text, at, row, t_ns, can_id, length, flags, data)
        if outcome == WIDEN_FIRST:
            report[STOP] = WIDEN
            break
        if outcome == FRAME:
            number = _channel_number(name, names, known)
            if number < 0:
                report[STOP] = NEW_CHANNEL
                break
            channel[row] = number
            row += 1
        line += 1
        count_lines(outcomes, first, outcome, line)
        at = end
    report[POSITION], report[LINES], report[ROWS] = at, line, row


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
    time, at = _parse_time(text, at)
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
        at = _parse_tail(text, at, row, flags)
    if at < 0:
        return MALFORMED, skip_line(text, -at), 0
    return FRAME, at, name


@array_kernel
def _channel_number(name: int, names: NameWords, known: int) -> int:
    """Return the number of a channel's name, -1 if it is new."""
    for index in range(known):
        if names.hashes[index] == name:
            return int(names.numbers[index])
    return -1


@array_kernel
def _parse_time(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``(seconds.fraction)``; return the time [ns], -1 if it is none, and the position behind it."""
    if text[at] != OPEN:
        return -1, at
    begin = at + 1
    seconds, at = decimal(text, begin, MAX_SECONDS_DIGITS)
    if at == begin or text[at] != POINT:
        return -1, at
    begin = at + 1
    fraction, at = decimal_parts(text, begin, NS_PER_S, NS_DIGITS)
    if at == begin or text[at] != CLOSE:
        return -1, at
    return seconds * NS_PER_S + fraction // NS_PER_US * NS_PER_US, at + 1


@array_kernel
def _parse_id(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``123#`` or ``12345678#``; return the identifier with its flags, -1 if it is none, and the position."""
    begin = at
    value, at = hexadecimal(text, begin, EXTENDED_DIGITS)
    digits = at - begin
    if text[at] != HASH or value > MAX_ID:
        return -1, at
    if digits == EXTENDED_DIGITS:
        return (value | EXTENDED_FLAG if value < ERROR_OR_ABOVE else value), at + 1
    if digits == STANDARD_DIGITS and value <= MAX_STANDARD_ID:
        return value, at + 1
    return -1, at


@array_kernel
def _payload(text: UInt8Array, at: int, row: int, data: UInt8Array, limit: int) -> tuple[int, int]:
    """Parse ``1122`` or ``11.22`` into a row that is zero behind it; return the count and the position."""
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
def _parse_tail(text: UInt8Array, at: int, row: int, flags: UInt8Array) -> int:
    """Pass over what may follow a payload; return the position behind the line, negative if it is anything else."""
    if text[at] == UNDERSCORE and HEX_VALUE[text[at + 1]] > PAYLOAD_BYTES:
        at += 2  # the raw length code above eight that some controllers send
    behind = skip_blanks(text, at)
    if behind > at and (text[behind] == 82 or text[behind] == 84):  # the direction, R or T, that candump -x appends
        flags[row] |= np.uint8(TX_FLAG if text[behind] == 84 else 0)
        behind = skip_blanks(text, behind + 1)
    return behind + 1 if text[behind] == NEWLINE else -behind
