"""Columns to the bytes of Parquet pages: dictionaries, runs and packed bits, in compiled loops.

The encodings are those of the format's specification: runs and packed bits (RLE), and DELTA_BINARY_PACKED.
"""

import numpy as np
import numpy.typing as npt

from canlog.arrays import Int64Array, UInt8Array
from canlog.jit import array_kernel, inlined_kernel

Int32Array = npt.NDArray[np.int32]

GROUP = 8  # values that are packed together
MOST_GROUPS = 63  # of a stretch of packed bits: its header is one byte
LEAST_RUN = 16  # values: a shorter run costs less as packed bits
DELTA_BLOCK = 128  # values of a block of differences
DELTA_PARTS = 4  # of a block, each with a width of its own
_SPREAD = np.uint64(0x9E37_79B9_7F4A_7C15)  # 2**64 divided by the golden ratio: multiples of it lie far apart
_WORD_BITS = 64


@array_kernel
def index_keys(key: Int64Array, table: Int32Array, distinct: Int64Array, index: Int32Array) -> int:
    """Give the different values of a column numbers in the order in which they come; return how many there are.

    ``table`` is room for a hash table, a power of two of more than as many places; ``distinct`` is filled with the
    values, ``index`` with the number of each row's.
    """
    bits = 0
    while 1 << bits < table.size:
        bits += 1
    shift, last = np.uint64(_WORD_BITS - bits), table.size - 1
    for row in range(table.size):
        table[row] = -1
    count = 0
    known = np.int32(0)
    for row in range(key.size):
        value = key[row]
        if row == 0 or value != key[row - 1]:
            place = np.int64((np.uint64(value) * _SPREAD) >> shift)
            while table[place] >= 0 and distinct[table[place]] != value:
                place = (place + 1) & last
            if table[place] < 0:
                table[place] = count
                distinct[count] = value
                count += 1
            known = table[place]
        index[row] = known
    return count


@inlined_kernel
def put_varint(out: UInt8Array, at: int, value: int) -> int:
    """Write a number in groups of seven bits, the lowest first; return the place behind it."""
    rest = np.uint64(value)
    while rest >= np.uint64(0x80):
        out[at] = np.uint8(rest & np.uint64(0x7F) | np.uint64(0x80))
        rest >>= np.uint64(7)
        at += 1
    out[at] = np.uint8(rest)
    return at + 1


@inlined_kernel
def put_bits(out: UInt8Array, at: int, values: Int64Array, width: int) -> int:
    """Write the lowest bits of some values one behind the other; return the place behind them."""
    held, count = np.uint64(0), 0
    for place in range(values.size):
        value = np.uint64(values[place])
        held |= value << np.uint64(count)
        taken = count + width
        if taken < _WORD_BITS:
            count = taken
        else:
            for _ in range(8):
                out[at] = np.uint8(held & np.uint64(0xFF))
                held >>= np.uint64(8)
                at += 1
            passed = _WORD_BITS - count
            held = value >> np.uint64(passed) if passed < _WORD_BITS else np.uint64(0)
            count = taken - _WORD_BITS
    while count > 0:
        out[at] = np.uint8(held & np.uint64(0xFF))
        held >>= np.uint64(8)
        at += 1
        count -= 8
    return at


@inlined_kernel
def put_run(out: UInt8Array, at: int, length: int, value: int, width: int) -> int:
    """Write a run of one value; return the place behind it."""
    at = put_varint(out, at, length << 1)
    for _ in range((width + 7) >> 3):
        out[at] = np.uint8(value & 0xFF)
        value >>= 8
        at += 1
    return at


@inlined_kernel
def run_length(index: Int32Array, row: int) -> int:
    """Return how many values from a row on are alike; less than LEAST_RUN if that is too few."""
    value, last = index[row], row + LEAST_RUN - 1
    if last >= index.size or index[last] != value:
        return 1
    stop = row + 1
    while stop < index.size and index[stop] == value:
        stop += 1
    return stop - row


@inlined_kernel
def put_group(out: UInt8Array, at: int, values: Int32Array, width: int) -> int:
    """Write up to GROUP values as packed bits, zeros for those that are missing; return the place behind them."""
    held, count, end = np.uint64(0), 0, at + width
    for place in range(values.size):
        held |= np.uint64(values[place]) << np.uint64(count)
        count += width
        while count >= GROUP:
            out[at] = np.uint8(held & np.uint64(0xFF))
            held >>= np.uint64(8)
            at += 1
            count -= 8
    while at < end:
        out[at] = np.uint8(held & np.uint64(0xFF))
        held >>= np.uint64(8)
        at += 1
    return end


@array_kernel
def pack_runs(index: Int32Array, width: int, out: UInt8Array) -> int:
    """Write numbers of up to ``width`` bits as runs and packed bits; return how many bytes that took."""
    at = row = groups = 0
    head = 0  # place of the header of the packed bits that are being written
    while row < index.size:
        length = run_length(index, row)
        if groups and (length >= LEAST_RUN or groups == MOST_GROUPS):
            out[head], groups = np.uint8(groups << 1 | 1), 0
        if length >= LEAST_RUN:
            at = put_run(out, at, length, index[row], width)
            row += length
            continue
        if not groups:
            head, at = at, at + 1
        at = put_group(out, at, index[row : row + GROUP], width)
        row += GROUP
        groups += 1
    if groups:
        out[head] = np.uint8(groups << 1 | 1)
    return at


@array_kernel
def pack_presence(row: Int64Array, count: int, out: UInt8Array) -> int:
    """Write which of ``count`` rows have a value, as definition levels of 0 and 1; return how many bytes that took.

    ``row`` are those that have one, rising. Few of them are written as runs, so that what is not there costs nothing;
    many as one bit for each row.
    """
    groups = (count + GROUP - 1) // GROUP
    if row.size == count:
        return put_run(out, 0, count, 1, 1)
    if row.size * 4 > groups:
        at = put_varint(out, 0, groups << 1 | 1)
        for place in range(groups):
            out[at + place] = 0
        for place in range(row.size):
            out[at + (row[place] >> 3)] |= np.uint8(1 << (row[place] & 7))
        return at + groups
    at, done, place = 0, 0, 0
    while place < row.size:
        first = place
        place += 1
        while place < row.size and row[place] == row[place - 1] + 1:
            place += 1
        if row[first] > done:
            at = put_run(out, at, row[first] - done, 0, 1)
        at = put_run(out, at, place - first, 1, 1)
        done = row[place - 1] + 1
    return put_run(out, at, count - done, 0, 1) if done < count else at


@inlined_kernel
def zigzag(value: int) -> int:
    """Return a number without its sign, small where the number is near zero."""
    return (value << 1) ^ (value >> 63)


@array_kernel
def pack_differences(value: Int64Array, held: Int64Array, out: UInt8Array) -> int:
    """Write whole numbers as DELTA_BINARY_PACKED; return how many bytes that took. ``held`` is room for a block."""
    part = DELTA_BLOCK // DELTA_PARTS
    at = put_varint(out, 0, DELTA_BLOCK)
    at = put_varint(out, at, DELTA_PARTS)
    at = put_varint(out, at, value.size)
    at = put_varint(out, at, zigzag(value[0]) if value.size else 0)
    row = 1
    while row < value.size:
        count = min(DELTA_BLOCK, value.size - row)
        least = value[row] - value[row - 1]
        for place in range(count):
            held[place] = value[row + place] - value[row + place - 1]
            least = min(least, held[place])
        for place in range(DELTA_BLOCK):
            held[place] = held[place] - least if place < count else 0
        at = put_varint(out, at, zigzag(least))
        widths = at
        at += DELTA_PARTS
        for number in range(DELTA_PARTS):
            bits = np.uint64(0)
            for place in range(number * part, (number + 1) * part):
                bits |= np.uint64(held[place])
            width = 0
            while bits:
                bits >>= np.uint64(1)
                width += 1
            out[widths + number] = width
            if number * part < count and width:
                at = put_bits(out, at, held[number * part : (number + 1) * part], width)
        row += count
    return at
