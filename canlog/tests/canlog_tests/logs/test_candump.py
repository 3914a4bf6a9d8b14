"""candump's grammar: what is a frame, what is not, and what the end of a file may hide."""

import pytest

from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs.candump import CandumpLog
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_log import reader_of
from tests.support.batches import read_whole


def read(text: bytes) -> tuple[FrameBatch, LogCounts]:
    return read_whole(reader_of(CandumpLog), text)


@pytest.mark.parametrize(
    ("line", "t_ns", "can_id", "length", "data"),
    [
        (b"(1767225600.000001) vcan0 0A0#1122334455667788", 1_767_225_600_000_001_000, 0xA0, 8, "1122334455667788"),
        (b"(0.5) can1 7fF#aBcd", 500_000_000, 0x7FF, 2, "abcd"),
        (b"(1.123456999)\tcan0  18FEF100#00", 1_123_456_000, 0x18FE_F100 | EXTENDED_FLAG, 1, "00"),
        (b"(1.0) can0 00000123#", 10**9, 0x123 | EXTENDED_FLAG, 0, ""),
        (b"(1.0) can0 123#R", 10**9, 0x123 | REMOTE_FLAG, 0, ""),
        (b"(1.0) can0 123#R8", 10**9, 0x123 | REMOTE_FLAG, 8, ""),
        (b"(1.0) can0 20000080#0000000000000000", 10**9, 0x80 | ERROR_FLAG, 8, ""),
        (b"(1.0) can0 123#11.22.33 R", 10**9, 0x123, 3, "112233"),
        (b"(1.0) can0 123#11 T\r", 10**9, 0x123, 1, "11"),
        (b"(1.0) can0 123#1122334455667788_E", 10**9, 0x123, 8, "1122334455667788"),
    ],
)
def test_a_line_becomes_a_frame(line: bytes, t_ns: int, can_id: int, length: int, data: str) -> None:
    batch, counts = read(line + b"\n")
    assert (batch.t_ns.tolist(), batch.can_id.tolist(), batch.length.tolist()) == ([t_ns], [can_id], [length])
    assert batch.data[0].tobytes() == bytes.fromhex(data).ljust(8, b"\0")
    assert counts == LogCounts(frames=1)


@pytest.mark.parametrize(
    "line",
    [
        b"hello",
        b"1.0 can0 123#11",
        b"(1.0 can0 123#11",
        b"(.5) can0 123#11",
        b"(1.) can0 123#11",
        b"(1.0000000001) can0 123#11",
        b"(12345678901.0) can0 123#11",
        b"(-1.0) can0 123#11",
        b"(1.0) 123#11",
        b"(1.0) can0 12#11",
        b"(1.0) can0 1234#11",
        b"(1.0) can0 800#11",
        b"(1.0) can0 F2345678#11",
        b"(1.0) can0 123456789#11",
        b"(1.0) can0 123 11",
        b"(1.0) can0 123#1",
        b"(1.0) can0 123#1G",
        b"(1.0) can0 123#112233445566778899",
        b"(1.0) can0 123#R9",
        b"(1.0) can0 123#11 X",
        *(b"(1.0) can0 123##" + payload for payload in (b"", b"G", b"0" + b"5A" * 9, b"0" + b"5A" * 65)),
        b"\xff\x00\x80",
    ],
)
def test_any_other_line_is_counted_with_its_number(line: bytes) -> None:
    good = b"(1.0) can0 123#11\n"
    batch, counts = read(good + b"\n" + line + b"\n" + good)
    assert batch.can_id.tolist() == [0x123, 0x123]
    assert counts == LogCounts(
        frames=2, skipped=1, rejected={LogReject.MALFORMED: 1}, first_rejected="line 3: malformed"
    )


@pytest.mark.parametrize(
    ("payload", "flags", "length"),
    [(b"0", FD_FLAG, 0), (b"1AB", FD_FLAG | BRS_FLAG, 1), (b"3" + b"5A" * 64, FD_FLAG | BRS_FLAG | ESI_FLAG, 64)],
)
def test_can_fd_is_taken_and_widens_what_follows(payload: bytes, flags: int, length: int) -> None:
    batch, counts = read(b"(1.0) can0 124#11\n(1.5) can0 123##" + payload + b"\n(2.0) can1 124#1122\n")
    assert batch.can_id.tolist() == [0x124, 0x123, 0x124]
    assert batch.length.tolist() == [1, length, 2]
    assert batch.flags.tolist() == [0, flags, 0]
    assert batch.channel.tolist() == [0, 0, 1]
    assert batch.data[0].tobytes() == b"\x11".ljust(64, b"\0")
    assert batch.data[1].tobytes() == bytes.fromhex(payload[1:].decode()).ljust(64, b"\0")
    assert counts == LogCounts(frames=3)
