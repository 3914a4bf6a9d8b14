"""The lines of a candump log, compiled: those that candump itself writes by eight characters, all others by one."""

import numpy as np

from clutch_model.jit import array_kernel, inlined_kernel
from diag_service.frames import EXTENDED_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, REMOTE_FLAG
from diag_service.records import Int64Array, UInt8Array, UInt32Array
from diag_service.sources.channels import NameWords
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
    RETURN,
    ROWS,
    SKIPPED,
    STOP,
    WIDEN,
    count_lines,
    hex_bytes,
    skip_blanks,
    skip_line,
)
from diag_service.sources.word_kernels import NO_DIGITS, UInt64Array, decimal_digits, hex_digits, reversed_bytes, word

STANDARD_DIGITS = 3
EXTENDED_DIGITS = 8
ERROR_OR_ABOVE = 0x2000_0000  # written with eight digits, yet not an extended identifier
MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x3FFF_FFFF
HIGHEST_STANDARD_DIGIT = 7
MAX_SECONDS_DIGITS = 10
NS_DIGITS = 9
NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
FD_DIGIT_BITS = 0x03  # of the digit behind "##": bit rate switch and error state, as in ``flags``

WIDEN_FIRST = 3  # beside the outcomes: a frame that does not fit into the arena
UNUSUAL = -1  # in place of the position behind a line
USUAL_TIME_BYTES = 20  # "(1767225600.000000) "
LONGEST_USUAL_BYTES = 64  # of a line with a name of seven characters and eight bytes, and the word behind it
NAME_SEED, NAME_FACTOR = -3750763034362895579, 1099511628211  # FNV-1a, 64 bits

# Characters of the grammar.
OPEN, CLOSE, POINT, HASH, UNDERSCORE = 40, 41, 46, 35, 95
LAST_DIGITS = np.uint64(8)  # bits by which the fraction moves up in its word, behind two zeros
TWO_ZEROS, NOT_TWO = np.uint64(0x3030), np.uint64(0xFFFF_FFFF_FFFF_0000)


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
            index, behind = _usual_line(
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


@inlined_kernel
def _usual_line(
    text: UInt8Array,
    at: int,
    row: int,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
    data_words: UInt64Array,
    names: NameWords,
    index: int,
    known: int,
) -> tuple[int, int]:
    """Parse ``(1767225600.000000) vcan0 0A0#11223344`` into a row; return the channel's place and the position behind.

    The position is UNUSUAL if anything stands elsewhere. ``index`` is the channel to try first.
    """
    time_ns = _usual_time_ns(text, at)
    name = word(text, at + USUAL_TIME_BYTES)
    if (name ^ names.words[index]) & names.masks[index]:
        index = _place_of_name(name, names, known)
    if time_ns < 0 or index < 0:
        return 0, UNUSUAL
    identifier, behind = _usual_id(text, at + USUAL_TIME_BYTES + names.bytes[index])
    if behind >= 0:
        behind = _usual_payload(text, behind, row, length, data, data_words)
    t_ns[row], can_id[row], flags[row], channel[row] = time_ns, identifier, 0, names.numbers[index]
    return index, behind


@inlined_kernel
def _usual_time_ns(text: UInt8Array, at: int) -> int:
    """Read ``(1767225600.000000)`` and a blank; negative if it is anything else, or more than 64 bits hold."""
    fraction = word(text, at + 11)
    pair = DECIMAL_PAIR[text[at + 9], text[at + 10]]
    seconds = decimal_digits(word(text, at + 1))
    micros = decimal_digits((fraction << LAST_DIGITS) & NOT_TWO | TWO_ZEROS)
    if text[at] != OPEN or text[at + 11] != POINT or text[at + 18] != CLOSE or text[at + 19] != BLANK:
        return UNUSUAL
    if seconds | pair | micros < 0:
        return UNUSUAL
    return int((seconds * 100 + pair) * NS_PER_S + micros * NS_PER_US)


@inlined_kernel
def _place_of_name(name: np.uint64, names: NameWords, known: int) -> int:
    """Return the place of a channel among those that are known, -1 if it is not among them."""
    for index in range(known):
        if (name ^ names.words[index]) & names.masks[index] == 0:
            return index
    return -1


@inlined_kernel
def _usual_id(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read ``0A0#`` or ``18FEF100#``; return the identifier and the position behind it, or UNUSUAL."""
    if text[at + STANDARD_DIGITS] == HASH:
        high, middle, low = HEX_VALUE[text[at]], HEX_VALUE[text[at + 1]], HEX_VALUE[text[at + 2]]
        is_usual = 0 <= high <= HIGHEST_STANDARD_DIGIT and middle | low >= 0
        return high << 8 | middle << 4 | low, at + STANDARD_DIGITS + 1 if is_usual else UNUSUAL
    digits = hex_digits(word(text, at)) if text[at + EXTENDED_DIGITS] == HASH else NO_DIGITS
    identifier = reversed_bytes(digits)
    is_usual = digits >= 0 and identifier < ERROR_OR_ABOVE
    return identifier | EXTENDED_FLAG, at + EXTENDED_DIGITS + 1 if is_usual else UNUSUAL


@inlined_kernel
def _usual_payload(
    text: UInt8Array, at: int, row: int, length: UInt8Array, data: UInt8Array, data_words: UInt64Array
) -> int:
    """Read up to eight bytes and the end of the line; return the position behind it, or UNUSUAL."""
    low, high = hex_digits(word(text, at)), hex_digits(word(text, at + 8))
    if low | high >= 0:
        at += 2 * PAYLOAD_BYTES
        length[row] = PAYLOAD_BYTES
        data_words[row, 0] = low | high << 32
    else:
        data_words[row, 0] = 0
        length[row], at = hex_bytes(text, at, row, data, PAYLOAD_BYTES, POINT)
    for index in range(1, data_words.shape[1]):
        data_words[row, index] = 0
    at += text[at] == RETURN
    return at + 1 if text[at] == NEWLINE else UNUSUAL


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
        at = _parse_tail(text, at)
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
def _parse_tail(text: UInt8Array, at: int) -> int:
    """Pass over what may follow a payload; return the position behind the line, negative if it is anything else."""
    if text[at] == UNDERSCORE and HEX_VALUE[text[at + 1]] > PAYLOAD_BYTES:
        at += 2  # the raw length code above eight that some controllers send
    behind = skip_blanks(text, at)
    if behind > at and (text[behind] == 82 or text[behind] == 84):  # the direction, R or T, that candump -x appends
        behind = skip_blanks(text, behind + 1)
    return behind + 1 if text[behind] == NEWLINE else -behind
