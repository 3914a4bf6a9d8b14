"""A line as candump itself writes it, compiled: eight characters at a time, at known places."""

import numpy as np

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import EXTENDED_FLAG, PAYLOAD_BYTES
from canlog.jit import inlined_kernel
from canlog.logs.channels import NameWords
from canlog.logs.text_kernels import BLANK, DECIMAL_PAIR, HEX_VALUE, NEWLINE, RETURN, hex_bytes
from canlog.logs.word_kernels import NO_DIGITS, UInt64Array, decimal_digits, hex_digits, reversed_bytes, word

STANDARD_DIGITS, EXTENDED_DIGITS = 3, 8
HIGHEST_STANDARD_DIGIT = 7
ERROR_OR_ABOVE = 0x2000_0000  # written with eight digits, yet not an extended identifier
NS_PER_S = 1_000_000_000
NS_PER_US = 1_000

UNUSUAL = -1  # in place of the position behind a line
USUAL_TIME_BYTES = 20  # "(1767225600.000000) "
LONGEST_USUAL_BYTES = 64  # of a line with a name of seven characters and eight bytes, and the word behind it

# Characters of the grammar.
OPEN, CLOSE, POINT, HASH = 40, 41, 46, 35
LAST_DIGITS = np.uint64(8)  # bits by which the fraction moves up in its word, behind two zeros
TWO_ZEROS, NOT_TWO = np.uint64(0x3030), np.uint64(0xFFFF_FFFF_FFFF_0000)


@inlined_kernel
def usual_line(
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
