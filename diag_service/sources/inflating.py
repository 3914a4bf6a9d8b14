"""Contents of sound containers, as fast as the machine inflates; whatever is not sound is left to whoever asked.

libdeflate does it where it is installed (asammdf brings it along), else zlib without its own checksum, which takes a
fifth of the time that inflating does. Either way the Adler-32 checksum at the end of the container is compared.
"""

import zlib
from collections.abc import Callable
from typing import Final

import numpy as np

from clutch_model.jit import array_kernel
from diag_service.records import UInt8Array

RAW_DEFLATE: Final = -zlib.MAX_WBITS
CHECKSUM_BYTES: Final = 4
METHOD_DEFLATE, METHOD_MASK, PRESET_DICTIONARY, HEADER_BYTES, HEADER_MODULUS = 8, 0x0F, 0x20, 2, 31
MOST_RATIO: Final = 1032  # of deflate: no container inflates to more
ADLER_MODULUS: Final = 65_521
ADLER_BLOCK_BYTES: Final = 4_096  # sums over so many bytes fit into 32 bits
_BYTE_BITS: Final = 8

Inflate = Callable[[bytes, int, int], "bytes | bytearray | None"]


def inflated_by_zlib(stream: bytes, stated_bytes: int, longest_padding: int) -> bytes | None:
    """Return what a zlib stream inflates to, None unless it is sound and followed by no more than padding.

    Parameters
    ----------
    stream : bytes
        The stream, and what follows it.
    stated_bytes : int
        To how much it should inflate; if it is more, the answer is None.
    longest_padding : int
        How many bytes may follow the stream.
    """
    method, flags = stream[:HEADER_BYTES].ljust(HEADER_BYTES, b"\0")
    is_zlib = method & METHOD_MASK == METHOD_DEFLATE and not flags & PRESET_DICTIONARY
    if not is_zlib or (method << _BYTE_BITS | flags) % HEADER_MODULUS:
        return None
    inflater = zlib.decompressobj(RAW_DEFLATE)
    try:
        data = inflater.decompress(memoryview(stream)[HEADER_BYTES:], stated_bytes + 1)
    except zlib.error:
        return None
    rest = inflater.unused_data
    is_whole = inflater.eof and len(data) <= stated_bytes
    is_sound = is_whole and CHECKSUM_BYTES <= len(rest) <= CHECKSUM_BYTES + longest_padding
    if not is_sound or adler32(np.frombuffer(data, np.uint8)) != int.from_bytes(rest[:CHECKSUM_BYTES]):
        return None
    return data


def _inflater_of_libdeflate() -> Inflate | None:
    """Return what ``inflated_by_zlib`` does, done by libdeflate; None if it is not installed."""
    try:
        import deflate  # noqa: PLC0415 - optional
    except ImportError:
        return None

    def inflated_by_libdeflate(stream: bytes, stated_bytes: int, longest_padding: int) -> bytearray | None:
        if not 0 < stated_bytes <= MOST_RATIO * len(stream):
            return None
        try:
            data = deflate.zlib_decompress(stream, stated_bytes)
        except deflate.DeflateError:
            return None
        # It does not say where the stream ended: its checksum must be where it ends without more than padding.
        checksum = deflate.adler32(data).to_bytes(CHECKSUM_BYTES)
        return data if checksum in stream[-CHECKSUM_BYTES - longest_padding :] else None

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
