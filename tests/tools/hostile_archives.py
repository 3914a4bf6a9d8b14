"""Packed files made to do harm: bombs of every compression, archives in archives, names that lead elsewhere."""

import bz2
import io
import lzma
import struct
import zipfile
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


def zipped(members: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, contents in members.items():
            archive.writestr(name, contents)
    return stream.getvalue()


def zip_in_zip() -> bytes:
    """Return an archive in an archive, nine deep: one that is unpacked without an end grows by a thousand each time."""
    inner = zipped({"drive.log": bytes(4 << 20)})
    for depth in range(9):
        inner = zipped({f"{depth} {k}.zip": inner for k in range(16)})
    return inner


def overlapping_zip() -> bytes:
    """Return an archive whose directory names the same 10 MB a thousand times."""
    single = zipped({"drive.log": LINE * 550_000})
    end = single.rindex(b"PK\x05\x06")
    start = single.rindex(b"PK\x01\x02")
    directory = single[start:end] * 1_000
    record = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 1_000, 1_000, len(directory), start, 0)
    return single[:start] + directory + record


PACKED: Mapping[str, Callable[[], bytes]] = MappingProxyType(
    {
        "bomb.log.gz": lambda: deflated(LINE * 60_000, 400, 31),
        "zeros.gz": lambda: deflated(bytes(1 << 20), 400, 31),
        "bomb.log.xz": xz_bomb,
        "zeros.log.bz2": bz2_bomb,
        "bomb.log.zst": lambda: zstd_bomb(LINE * 500_000, 60),
        "zeros.log.zst": lambda: zstd_bomb(bytes(8 << 20), 60),
        "window.log.zst": zstd_window,
        "bomb.zip": lambda: zipped({"drive.log": LINE + bytes(400 << 20)}),
        "nested.zip": zip_in_zip,
        "members.zip": lambda: zipped({f"{k}.log": LINE for k in range(20_000)}),
        "thousand.zip": lambda: zipped({f"{k}.txt": b"nothing of interest" for k in range(1_000)}),
        "overlapping.zip": overlapping_zip,
        "names.zip": lambda: zipped({"../../outside.log": LINE, "/etc/outside.log": b"", "a/../b\\..\\c.log": LINE}),
    }
)
"""By name, what is in the file."""
QUICKLY_REFUSED = frozenset({"bomb.log.gz", "zeros.gz", "bomb.log.xz", "bomb.log.zst"})
