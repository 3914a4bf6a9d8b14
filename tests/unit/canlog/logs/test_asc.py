"""Vector ASC: header lines that decide how the others are read, and the kinds of line there are."""

from datetime import datetime

import pytest

from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs.asc import AscLog
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_log import reader_of
from tests.support.batches import read_whole

HEADER = b"date Thu Jan 01 10:00:00.500 2026\nbase hex  timestamps absolute\ninternal events logged\n"
START_NS = int(datetime(2026, 1, 1, 10).timestamp()) * 10**9 + 500_000_000  # noqa: DTZ001 - local, as in the format


def read(text: bytes) -> tuple[FrameBatch, LogCounts]:
    return read_whole(reader_of(AscLog), text)


@pytest.mark.parametrize(
    ("event", "can_id", "length", "data"),
    [
        (b"1  A0              Rx   d 8 11 22 33 44 55 66 77 88", 0xA0, 8, "1122334455667788"),
        (b"2  18FEF100x       Tx   d 2 0A ff", 0x18FE_F100 | EXTENDED_FLAG, 2, "0aff"),
        (b"1  123             Rx   d 0", 0x123, 0, ""),
        (b"1  123  d 2 01 02", 0x123, 2, "0102"),  # no direction: received
        (b"1  123             Rx   d 2 01 02  Length = 0 BitCount = 64 ID = 291", 0x123, 2, "0102"),
        (b"1  123             Rx   r", 0x123 | REMOTE_FLAG, 0, ""),
        (b"1  123             Rx   r 4", 0x123 | REMOTE_FLAG, 4, ""),
        (b"1  ErrorFrame", ERROR_FLAG, 0, ""),
        (b"CANFD   1 Rx        123  Name 0 0 2  2 11 22  0  0  0  0", 0x123, 2, "1122"),
        (b"CANFD   1 Rx        123  1 0 2  2 11 22  130000  130  200000 0 0 0 0 0", 0x123, 2, "1122"),
    ],
)
def test_an_event_becomes_a_frame(event: bytes, can_id: int, length: int, data: str) -> None:
    batch, counts = read(HEADER + b"   1.000002 " + event + b"\n")
    assert batch.t_ns.tolist() == [START_NS + 1_000_002_000]
    assert (batch.can_id.tolist(), batch.length.tolist()) == ([can_id], [length])
    assert batch.data[0].tobytes() == bytes.fromhex(data).ljust(8, b"\0")
    assert counts == LogCounts(frames=1, skipped=3)


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (b"1  A0  Rx   d 8 11 22 33", LogReject.MALFORMED),
        (b"1  A0  Rx   d 1 100", LogReject.MALFORMED),
        (b"1  A0Z Rx   d 1 10", LogReject.MALFORMED),
        (b"1  800 Rx   d 1 10", LogReject.MALFORMED),
        (b"1  3FFFFFFFx Rx   d 1 10", LogReject.MALFORMED),
        (b"1  \xff\x01\x02", LogReject.MALFORMED),
        (b"CANFD   1 Rx  123  1 0 9 13 " + b"11 " * 13 + b"0 0 303000 0 0 0 0 0", LogReject.MALFORMED),
        (b"CANFD   1 Rx  123  1 0 9 12 " + b"11 " * 11 + b"0 0 303000 0 0 0 0 0", LogReject.MALFORMED),
        (b"CANFD   1 Rx  123  1 0 9 12 " + b"11 " * 12 + b"0 0 0 0 0 0 0 0", LogReject.MALFORMED),
    ],
)
def test_what_looks_like_a_frame_and_is_none_is_counted(event: bytes, reason: LogReject) -> None:
    good = b"1.0 1  A0  Rx   d 1 11\n"
    batch, counts = read(HEADER + good + b"1.5 " + event + b"\n" + good)
    assert len(batch) == 2
    assert counts.rejected == {reason: 1}
    assert counts.first_rejected == f"line 5: {reason}"


@pytest.mark.parametrize(
    ("code", "base", "length"),
    [
        (b"9", b"hex", 12),
        (b"f", b"hex", 64),
        (b"c", b"hex", 24),
        (b"c", b"hex", 12),
        (b"12", b"hex", 12),
        (b"64", b"hex", 64),
        (b"9", b"dec", 12),
        (b"15", b"dec", 64),
        (b"16", b"dec", 16),
        (b"12", b"dec", 12),
    ],
)
def test_more_than_eight_bytes_behind_a_d_are_those_of_can_fd(code: bytes, base: bytes, length: int) -> None:
    """A code of the DLC field, or the number of bytes itself, as the bytes that follow show."""
    payload = bytes(range(10, 10 + length))
    shown = b" ".join(b"%02x" % byte if base == b"hex" else b"%d" % byte for byte in payload)
    text = b"base " + base + b" timestamps absolute\n1.0 1 100 Rx d " + code + b" " + shown
    batch, counts = read(text + b"  Length = 0 BitCount = 64\n1.1 1 100 Rx d 1 10\n")
    assert counts == LogCounts(frames=2, skipped=1)
    assert (batch.length.tolist(), batch.flags.tolist()) == ([length, 1], [FD_FLAG, 0])
    assert batch.data[0, :length].tobytes() == payload
    assert not batch.data[0, length:].any()
