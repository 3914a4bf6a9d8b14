"""The compiled reader of messages of NMEA 2000: identifiers in parts, and bytes that may be more than a frame has."""

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import EXTENDED_FLAG, PAYLOAD_BYTES
from canlog.jit import array_kernel
from canlog.logs.columns import fields
from canlog.logs.columns.roles import DECIMAL, Role
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.text_kernels import FRAME, MALFORMED, SKIPPED

# What has been read of a line; a message longer than a frame; and of which groups there are such messages.
TIME_US, ID, MEANING, LENGTH, CHANNEL, COUNT, DESTINATION, MESSAGE = range(8)
MOST_MESSAGE_BYTES = 223
FIRST_GROUP, MOST_GROUP = 0x1E000, 0x1FFFF  # all that may be longer than a frame
SEEN = MESSAGE + MOST_MESSAGE_BYTES
FIELDS = SEEN + MOST_GROUP - FIRST_GROUP + 1
UNKNOWN = -1
NO_FRAME_ID = -2  # a group beyond those of any bus: what gateways say of themselves

# The clock of a file, how many of its first lines hold no frames, and how many messages were cut into frames.
BASE_US, NOW_US, WRAP_US, LAPS_US, IS_RELATIVE, HEADER_LINES, CUT_MESSAGES, CLOCK_FIELDS = range(8)

FIRST_BYTES, NEXT_BYTES, PADDING = 6, 7, 0xFF  # of fast packets
ADDRESS_DIGITS, MOST_PRIORITY, MOST_ADDRESS, BROADCAST_FORMAT = 5, 7, 0xFF, 0xF0


@array_kernel
def read_part(text: UInt8Array, begin: int, stop: int, role: int, base: int, line: Int64Array) -> bool:
    """Read a part of an identifier of 29 bits."""
    if role == Role.ADDRESSES:
        value = fields.hexadecimal_field(text, begin, stop)
        part = (value & 0x7) << 26 | value >> 12
        line[DESTINATION] = value >> 4 & 0xFF
        is_sound = stop - begin == ADDRESS_DIGITS and value & 0xF <= MOST_PRIORITY
    else:
        value = fields.identifier(text, begin, stop, max(base, DECIMAL), line, MEANING, 0)
        most = MOST_GROUP * 4 if role == Role.GROUP else MOST_PRIORITY if role == Role.PRIORITY else MOST_ADDRESS
        part = value << (26 if role == Role.PRIORITY else 8 if role == Role.GROUP else 0)
        is_sound = 0 <= value <= most
    if role == Role.DESTINATION:
        line[DESTINATION], part = value, 0
    line[MEANING] |= EXTENDED_FLAG
    is_group = role == Role.GROUP and value > MOST_GROUP * 2 + 1
    line[ID] = NO_FRAME_ID if is_group or line[ID] == NO_FRAME_ID else max(line[ID], 0) | part
    return bool(is_sound)


@array_kernel
def check_message(line: Int64Array) -> int:
    """Return whether a message has all of its bytes; what is longer than a frame is stored by ``store_message``."""
    count = line[COUNT]
    if line[ID] == NO_FRAME_ID:
        return SKIPPED
    if count < line[LENGTH] or count > MOST_MESSAGE_BYTES:
        return MALFORMED
    line[COUNT] = count = line[LENGTH] if line[LENGTH] >= 0 else count
    line[LENGTH] = min(count, PAYLOAD_BYTES)
    if line[DESTINATION] >= 0 and (line[ID] >> 16 & 0xFF) < BROADCAST_FORMAT:
        line[ID] = line[ID] & ~0xFF00 | line[DESTINATION] << 8
    return FRAME


@array_kernel
def store_message(rows: FrameRows, row: int, clock: Int64Array, line: Int64Array) -> int:
    """Write the bytes of a message whose first frame is in this row; return how many frames there are behind it.

    One that is longer than a frame, or of a group that has such, becomes the fast packet that carried it.
    """
    count, group = line[COUNT], (line[ID] >> 8 & 0x3FFFF) - FIRST_GROUP
    group -= 0 if (line[ID] >> 16 & 0xFF) >= BROADCAST_FORMAT else group & 0xFF
    is_cut = count > PAYLOAD_BYTES
    if 0 <= group < FIELDS - SEEN:
        is_cut = is_cut or line[SEEN + group] > 0
        line[SEEN + group] = is_cut
    if not is_cut:
        for place in range(PAYLOAD_BYTES):
            rows.data[row, place] = line[MESSAGE + place] if place < count else 0
        return 0
    clock[CUT_MESSAGES] += 1
    place, frames = 0, 1 + max(0, count - FIRST_BYTES + NEXT_BYTES - 1) // NEXT_BYTES
    for number in range(frames):
        for column in range(rows.data.shape[1]):
            is_filled = column > (number == 0) and column < PAYLOAD_BYTES
            is_padding = column < PAYLOAD_BYTES and place >= count
            rows.data[row, column] = (
                line[MESSAGE + place] if is_filled and not is_padding else PADDING if is_padding else 0
            )
            place += is_filled
        rows.data[row, 0] = clock[CUT_MESSAGES] % 8 << 5 | number
        if number == 0:
            rows.data[row, 1] = count
        rows.t_ns[row], rows.can_id[row] = rows.t_ns[row - number], rows.can_id[row - number]
        rows.flags[row], rows.channel[row] = rows.flags[row - number], rows.channel[row - number]
        rows.length[row] = PAYLOAD_BYTES
        row += 1
    return int(frames) - 1
