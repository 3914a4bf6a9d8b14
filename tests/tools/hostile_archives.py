"""Packed files made to do harm: bombs of every compression."""

import bz2
import lzma
import struct
import zlib
from collections.abc import Callable, Mapping
from types import MappingProxyType

import zstandard

LINE = b"(1.0) can0 123#11\n"
LINES = LINE * 2_000


def deflated(contents: bytes, times: int, wbits: int) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, wbits)
    return b"".join(packer.compress(contents) for _ in range(times)) + packer.flush()


def xz_bomb() -> bytes:
    packer = lzma.LZMACompressor(preset=0)
    block = LINE * 60_000
    return b"".join(packer.compress(block) for _ in range(400)) + packer.flush()


def bz2_bomb() -> bytes:
    packer = bz2.BZ2Compressor(9)
    block = bytes(9 << 20)
    return b"".join(packer.compress(block) for _ in range(40)) + packer.flush()


def zstd_bomb(block: bytes, times: int) -> bytes:
    """Return frames one behind the other, each of which becomes a block."""
    return zstandard.compress(block, 19) * times


def zstd_window() -> bytes:
    """Return a frame that wants a window of 2 GiB before it gives its first byte."""
    return struct.pack("<LBB", 0xFD2FB528, 0x00, 21 << 3) + struct.pack("<L", 1 << 3 | 1 << 1)[:3] + b"\0" * (1 << 20)


PACKED: Mapping[str, Callable[[], bytes]] = MappingProxyType(
    {
        "bomb.log.gz": lambda: deflated(LINE * 60_000, 400, 31),
        "zeros.gz": lambda: deflated(bytes(1 << 20), 400, 31),
        "bomb.log.xz": xz_bomb,
        "zeros.log.bz2": bz2_bomb,
        "bomb.log.zst": lambda: zstd_bomb(LINE * 500_000, 60),
        "zeros.log.zst": lambda: zstd_bomb(bytes(8 << 20), 60),
        "window.log.zst": zstd_window,
    }
)
"""By name, what is in the file."""
QUICKLY_REFUSED = frozenset({"bomb.log.gz", "zeros.gz", "bomb.log.xz", "bomb.log.zst"})
