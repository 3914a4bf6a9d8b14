"""Contents of sound containers, as fast as the machine inflates; whatever is not sound is left to whoever asked.

libdeflate does it where it is installed (asammdf brings it along), else zlib without its own checksum, which takes a
fifth of the time that inflating does. Either way the Adler-32 checksum at the end of the container is compared.
"""

import zlib
from collections.abc import Callable
from typing import Final

import numpy as np

from canlog.arrays import UInt8Array
from canlog.jit import array_kernel

RAW_DEFLATE: Final = -zlib.MAX_WBITS
CHECKSUM_BYTES: Final = 4
METHOD_DEFLATE, METHOD_MASK, PRESET_DICTIONARY, HEADER_BYTES, HEADER_MODULUS = 8, 0x0F, 0x20, 2, 31
MOST_RATIO: Final = 1032  # of deflate: nothing inflates to more
MOST_BYTES: Final = 256 * 1024 * 1024  # writers put 128 KiB into a container; larger ones go the slower way
ADLER_MODULUS: Final = 65_521
ADLER_BLOCK_BYTES: Final = 4_096  # sums over so many bytes fit into 32 bits
_BYTE_BITS: Final = 8

Inflate = Callable[[memoryview, int, int], "bytes | bytearray | None"]


def inflated_by_zlib(stream: memoryview, stated_bytes: int, longest_padding: int) -> bytes | None:
    """Return what a zlib stream inflates to, None unless it is sound and followed by no more than padding.

    ``stated_bytes`` is to how much it should inflate; if it is more, the answer is None.
    """
    method, flags = bytes(stream[:HEADER_BYTES]).ljust(HEADER_BYTES, b"\0")
    is_zlib = method & METHOD_MASK == METHOD_DEFLATE and not flags & PRESET_DICTIONARY
    if not is_zlib or (method << _BYTE_BITS | flags) % HEADER_MODULUS:
        return None
    # It may inflate to more than is stated, up to MOST_RATIO times its size, before anyone can say no.
    if not 0 < stated_bytes <= MOST_BYTES or len(stream) * MOST_RATIO > MOST_BYTES:
        return None
    try:
        data = zlib.decompress(stream[HEADER_BYTES:], RAW_DEFLATE, stated_bytes)
    except zlib.error:
        return None
    is_sound = len(data) <= stated_bytes and ends_with(stream, adler32(np.frombuffer(data, np.uint8)), longest_padding)
    return data if is_sound else None


def ends_with(stream: memoryview, checksum: int, longest_padding: int) -> bool:
    """Return whether a checksum stands at the end of a stream, before no more than padding.

    The libraries do not say where the stream ended.
    """
    return checksum.to_bytes(CHECKSUM_BYTES) in bytes(stream[-CHECKSUM_BYTES - longest_padding :])


def _inflater_of_libdeflate() -> Inflate | None:
    """Return what ``inflated_by_zlib`` does, done by libdeflate; None if it is not installed."""
    try:
        import deflate  # noqa: PLC0415 - optional
    except ImportError:
        return None

    def inflated_by_libdeflate(stream: memoryview, stated_bytes: int, longest_padding: int) -> bytearray | None:
        if not 0 < stated_bytes <= min(MOST_BYTES, MOST_RATIO * len(stream)):
            return None
        try:
            data = deflate.zlib_decompress(stream, stated_bytes)
        except deflate.DeflateError:
            return None
        return data if ends_with(stream, deflate.adler32(data), longest_padding) else None

    return inflated_by_libdeflate


inflated_by_libdeflate: Final[Inflate | None] = _inflater_of_libdeflate()
sound_contents: Final[Inflate] = inflated_by_libdeflate or inflated_by_zlib


@array_kernel
def adler32(data: UInt8Array) -> int:
    """Return the Adler-32 checksum of some bytes (RFC 1950)."""
    low, high, at = 1, 0, 0
    while at < data.size:
        count = min(ADLER_BLOCK_BYTES, data.size - at)
        total, weighted = np.uint32(0), np.uint32(0)
        for index in range(count):
            byte = np.uint32(data[np.uint64(at + index)])
            total += byte
            weighted += byte * np.uint32(index)
        # Byte k of a block is in the higher sum as often as bytes from it on are left: count - k times.
        high = int((high + count * (low + np.int64(total)) - np.int64(weighted)) % ADLER_MODULUS)
        low = int((low + np.int64(total)) % ADLER_MODULUS)
        at += count
    return int(high << 16 | low)
