"""candump logs (``candump -l``): ``(1767225600.000000) vcan0 0A0#1122334455667788``, FD frames with ``##``, to columns.

Times keep the whole microseconds that candump writes; further digits are cut off. Lines that do not follow the grammar
are counted with the number of the first one, and reading goes on.
"""

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import EXTENDED_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, REMOTE_FLAG, TX_FLAG, FrameBatch
from canlog.jit import kernel, part
from canlog.logs.text_kernels import (
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
    TOO_LONG,
    ChannelNames,
    FrameRows,
    NameWords,
    channel_number,
    clear,
    count_line,
    decimal,
    decimal_parts,
    digits,
    hex_bytes,
    skip_blanks,
    skip_line,
    skip_word,
)
from canlog.logs.text_log import MAX_LINE_BYTES, KernelLog

STANDARD_DIGITS, EXTENDED_DIGITS = 3, 8
MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x3FFF_FFFF
ERROR_OR_ABOVE = 0x2000_0000  # written with eight digits, yet not an extended identifier
MAX_SECONDS_DIGITS, NS_DIGITS = 10, 9
NS_PER_S, NS_PER_US = 1_000_000_000, 1_000
FD_DIGIT_BITS = 0x03  # of the digit behind "##": bit rate switch and error state, as in ``flags``

# Characters of the grammar.
OPEN, CLOSE, POINT, HASH, UNDERSCORE = ord("("), ord(")"), ord("."), ord("#"), ord("_")
LETTER_R, LETTER_T, SMALL_R = ord("R"), ord("T"), ord("r")


@kernel
def parse_lines(text: UInt8Array, rows: FrameRows, names: NameWords, known: int, progress: Int64Array) -> None:
    """Parse lines from where the progress says; ``known`` channels have a number."""
    at, line, row = progress[POSITION], progress[LINES], progress[ROWS]
    while at < len(text):
        outcome, behind = _parse_line(text, at, rows, row, names, known)
        if outcome >= TOO_LONG:
            progress[STOP] = outcome
            break
        row += outcome == FRAME
        line += 1
        count_line(progress, outcome, line)
        at = behind
    progress[POSITION], progress[LINES], progress[ROWS] = at, line, row


@part
def _parse_line(text: UInt8Array, at: int, rows: FrameRows, row: int, names: NameWords, known: int) -> tuple[int, int]:
    """Parse one line into one row; return the outcome and the position behind the line."""
    at = skip_blanks(text, at)
    if text[at] == NEWLINE:
        return SKIPPED, at + 1
    rows.t_ns[row], at = _parse_time(text, at)
    name_at = skip_blanks(text, at)
    identifier, at = _parse_id(text, skip_blanks(text, skip_word(text, name_at)))
    if rows.t_ns[row] < 0 or identifier < 0:
        return MALFORMED, skip_line(text, at)
    flags, limit = 0, PAYLOAD_BYTES
    if text[at] == HASH:
        if rows.data.shape[1] < FD_PAYLOAD_BYTES:
            return TOO_LONG, at
        digit = HEX_VALUE[text[at + 1]]
        if digit < 0:
            return MALFORMED, skip_line(text, at)
        flags, limit, at = FD_FLAG | (digit & FD_DIGIT_BITS), FD_PAYLOAD_BYTES, at + 2
    if limit == PAYLOAD_BYTES and (text[at] == LETTER_R or text[at] == SMALL_R):
        identifier |= REMOTE_FLAG
        clear(rows.data, row, 0)
        length, at = decimal(text, at + 1, 1)
    else:
        length, at = hex_bytes(text, at, row, rows.data, limit, POINT)
    rows.can_id[row], rows.length[row] = identifier, length
    is_sent, at = _parse_tail(text, at)
    rows.flags[row] = flags | TX_FLAG * is_sent
    if at < 0 or not IS_LENGTH[length]:
        return MALFORMED, at if at > 0 else skip_line(text, -at)
    number = channel_number(text, name_at, names, known)
    rows.channel[row] = max(number, 0)
    return (FRAME if number >= 0 else NEW_CHANNEL), at


@part
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


@part
def _parse_id(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``123#`` or ``12345678#``; return the identifier with its flags, -1 if it is none, and the position."""
    begin = at
    value, at = digits(text, begin, 16, EXTENDED_DIGITS)
    count = at - begin
    if text[at] != HASH or value > MAX_ID:
        return -1, at
    if count == EXTENDED_DIGITS:
        return (value | EXTENDED_FLAG if value < ERROR_OR_ABOVE else value), at + 1
    if count == STANDARD_DIGITS and value <= MAX_STANDARD_ID:
        return value, at + 1
    return -1, at


@part
def _parse_tail(text: UInt8Array, at: int) -> tuple[bool, int]:
    """Pass over what may follow a payload; return whether the frame was sent, and the position behind the line.

    The position is negative if anything else follows.
    """
    if text[at] == UNDERSCORE and HEX_VALUE[text[at + 1]] > PAYLOAD_BYTES:
        at += 2  # the raw length code above eight that some controllers send
    behind = skip_blanks(text, at)
    has_direction = behind > at and (text[behind] == LETTER_T or text[behind] == LETTER_R)  # that candump -x appends
    is_sent = has_direction and text[behind] == LETTER_T
    if has_direction:
        behind = skip_blanks(text, behind + 1)
    return is_sent, behind + 1 if text[behind] == NEWLINE else -behind


class CandumpLog(KernelLog):
    shortest_line_bytes = 12  # "(0.0)c 123#"

    def __init__(self) -> None:
        super().__init__()
        self._channels = ChannelNames()

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines; a channel that is met for the first time gets its number."""
        parse_lines(text, rows, self._channels.words, len(self._channels), progress)
        if progress[STOP] == NEW_CHANNEL:
            line = text[progress[POSITION] :][:MAX_LINE_BYTES].tobytes()
            self._channels.add(line.partition(b")")[2].split(maxsplit=1)[0])

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:  # noqa: ARG002 - the grammar's length decides
        """Return whether a payload is so long that no byte can be missing."""
        return frame.length[0] in {PAYLOAD_BYTES, FD_PAYLOAD_BYTES}
