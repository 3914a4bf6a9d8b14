"""BLF: every kind of frame object, and containers that lie about themselves."""

import struct
import zlib
from collections.abc import Sequence

import pytest

from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs.blf import FILE_HEADER, read_blf
from canlog.logs.log_counts import LogCounts, LogReject
from tests.support.batches import read_whole

START_NS = 1_767_225_600_123_000_000  # 2026-01-01 00:00:00.123
SYSTEMTIME = (2026, 1, 4, 1, 0, 0, 0, 123)
NANOSECONDS, TEN_MICROSECONDS = 2, 1


def message(t_ns: int = 0, *, can_id: int = 0x123, payload: bytes = b"\x01\x02", flags: int = 0) -> bytes:
    body = struct.pack("<HBBL8s", 1, flags, len(payload), can_id, payload)
    return an_object(1, body, t_ns)


def an_object(kind: int, body: bytes, time: int = 0, unit: int = NANOSECONDS, version: int = 1) -> bytes:
    stamp = struct.pack("<LHHQ", unit, 0, 0, time) if version == 1 else struct.pack("<LBxHQ8x", unit, 0, 0, time)
    header = struct.pack("<4sHHLL", b"LOBJ", 16 + len(stamp), version, 16 + len(stamp) + len(body), kind)
    return header + stamp + body


def container(contents: bytes, *, method: int = 2, size: int | None = None) -> bytes:
    data = zlib.compress(contents) if method == 2 else contents
    total = 32 + len(data) if size is None else size
    return struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, total, 10, method, len(contents)) + data + bytes(len(data) % 4)


def blf(containers: Sequence[bytes], *, start: Sequence[int] = SYSTEMTIME, stated_bytes: int | None = None) -> bytes:
    body = b"".join(containers)
    total = 144 + len(body) if stated_bytes is None else stated_bytes
    header = FILE_HEADER.pack(b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, total, 0, 0, 0, *start, *start)
    return header.ljust(144, b"\0") + body


def read(contents: bytes) -> tuple[FrameBatch, LogCounts]:
    return read_whole(read_blf, contents)


def length_code(payload: bytes) -> int:
    return {12: 9}.get(len(payload), len(payload))


def fd_body(payload: bytes, edl: int) -> bytes:
    return struct.pack("<HBBLLBBB5x64s", 1, 0, length_code(payload), 0x321, 0, 0, edl, len(payload), payload)


def fd64_body(payload: bytes, flags: int) -> bytes:
    fields = (1, length_code(payload), len(payload), 0, 0x321, 0, flags, 0, 0, 0, 0, 0, 0, 0, 0)
    return struct.pack("<BBBBLLLLLLLHBBL", *fields) + payload


@pytest.mark.parametrize(
    ("contents", "can_id", "length", "data"),
    [
        (message(), 0x123, 2, "0102"),
        (message(can_id=0x98FEF100), 0x18FE_F100 | EXTENDED_FLAG, 2, "0102"),
        (message(flags=0x80, payload=b"\x01\x02\x03"), 0x123 | REMOTE_FLAG, 3, ""),
        (an_object(86, struct.pack("<HBBL8sLBBH", 1, 0, 1, 0x123, b"\x09\xff", 0, 0, 0, 0)), 0x123, 1, "09"),
        (an_object(73, bytes(32)), ERROR_FLAG, 0, ""),
        (an_object(100, fd_body(b"\x01\x02\x03", edl=0)), 0x321, 3, "010203"),
        (an_object(101, fd64_body(b"\x01\x02\x03", flags=0)), 0x321, 3, "010203"),
        (an_object(101, fd64_body(b"", flags=0x10)), 0x321 | REMOTE_FLAG, 0, ""),
    ],
)
def test_an_object_becomes_a_frame(contents: bytes, can_id: int, length: int, data: str) -> None:
    batch, counts = read(blf([container(contents)]))
    assert (batch.can_id.tolist(), batch.length.tolist()) == ([can_id], [length])
    assert batch.data[0].tobytes() == bytes.fromhex(data).ljust(8, b"\0")
    assert batch.t_ns.tolist() == [START_NS]
    assert counts == LogCounts(frames=1)


@pytest.mark.parametrize(
    ("contents", "flags"),
    [
        (an_object(100, fd_body(bytes(range(12)), 1)), FD_FLAG),
        (an_object(100, fd_body(bytes(range(12)), 7)), FD_FLAG | BRS_FLAG | ESI_FLAG),
        (an_object(101, fd64_body(bytes(range(12)), 0x1000)), FD_FLAG),
        (an_object(101, fd64_body(bytes(range(12)), 0x3000)), FD_FLAG | BRS_FLAG),
    ],
)
def test_can_fd_is_taken(contents: bytes, flags: int) -> None:
    batch, counts = read(blf([container(message() + contents + message())]))
    assert batch.can_id.tolist() == [0x123, 0x321, 0x123]
    assert batch.length.tolist() == [2, 12, 2]
    assert batch.flags.tolist() == [0, flags, 0]
    assert batch.data[1].tobytes() == bytes(range(12)).ljust(64, b"\0")
    assert batch.data[2].tobytes() == b"\x01\x02".ljust(64, b"\0")
    assert counts == LogCounts(frames=3)


@pytest.mark.parametrize("method", [0, 2])
@pytest.mark.parametrize("is_past_the_end", [False, True])
def test_a_container_whose_size_swallows_the_next_ones_gives_them_back(method: int, *, is_past_the_end: bool) -> None:
    swallowing = bytearray(container(message(can_id=5), method=method))
    following = container(message(can_id=6)) + container(message(can_id=7))
    swallowing[8:12] = struct.pack("<L", len(swallowing) + len(following) + 1000 * is_past_the_end)
    batch, counts = read(blf([bytes(swallowing) + following]))
    assert batch.can_id.tolist() == [5, 6, 7]
    assert counts.rejected == {LogReject.CUT_OFF if is_past_the_end else LogReject.DAMAGED: 1}


@pytest.mark.parametrize("cut", range(1, 49))
def test_an_object_that_the_next_container_continues_is_whole(cut: int) -> None:
    contents = b"".join(message(1_000 * k, payload=bytes([k])) for k in range(6))
    middle, last = container(contents[cut : cut + 100]), container(contents[cut + 100 :], method=0)
    batch, counts = read(blf([container(contents[:cut]), middle, last]))
    assert batch.data[:, 0].tolist() == list(range(6))
    assert counts == LogCounts(frames=6)
