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


def test_events_of_other_kinds_and_comments_are_skipped() -> None:
    others = (
        b"// version 8.1.0\n\nBegin Triggerblock Thu Jan 01 10:00:00.500 2026\n0.000000 Start of measurement\n"
        b"1.0 1  Statistic: D 0 R 0 XD 0\n1.1 CAN 1 Status:chip status error active\n"
        b"1.2 1  A0 TxRq d 1 11\n1.2 1  A0 R d 1 11\n1.3 1  A0 Rx d 1 11\nEnd TriggerBlock\n"
    )
    batch, counts = read(HEADER + others)
    assert batch.t_ns.tolist() == [START_NS + 1_300_000_000]
    assert counts == LogCounts(frames=1, skipped=12)


def test_relative_times_add_up_over_every_event() -> None:
    text = (
        b"date Thu Jan 01 10:00:00.500 2026\nbase hex timestamps relative\n"
        b"1.0 1 A0 Rx d 0\n0.25 CAN 1 Status:ok\n0.25 1 A0 Rx d 0\n"
    )
    batch, _ = read(text)
    assert (batch.t_ns - START_NS).tolist() == [1_000_000_000, 1_500_000_000]


@pytest.mark.parametrize("missing", range(2, 36))
def test_a_frame_cut_off_by_the_end_is_counted(missing: int) -> None:
    whole = b"1.0 1  A0  Rx   d 8 11 22 33 44 55 66 77 88\n"
    batch, counts = read(HEADER + whole + whole[:-missing])
    assert len(batch) == 1
    assert counts.truncated
    assert counts.rejected == {LogReject.CUT_OFF: 1}


@pytest.mark.parametrize(
    "event",
    [
        b"1  123  Rx   d 13 01 02 03 04 05 06 07 08 09 10 11 12 13",  # no frame is so long
        b"1  123  Rx   d 1 01 02",
        b"1  123  Rx   d 3 01 02",
        b"1  123  Rx   d 0 01",
        b"1  123  Rx   d 9 01 02 03 04 05 06 07",
        b"1  123  Rx   d",
        b"1  123  Rx   d 1 01 02 // comment",
        b"1  123  Rx   d FF 01",
        b"1  123  Rx   d g 01",
        b"CANFD 1 Rx 123 0 0 8 7 01 02 03 04 05 06 07 0 0 1000 0 0 0 0 0",
        b"CANFD 1 Rx 123 0 0 9 8 01 02 03 04 05 06 07 08 0 0 1000 0 0 0 0 0",
        b"CANFD 1 Rx 123 0 0 2 300 01",
    ],
)
@pytest.mark.parametrize("base", [b"base hex", b"base dec"])
def test_a_length_and_bytes_that_disagree_are_no_frame(event: bytes, base: bytes) -> None:
    good = b"1.0 1  16  Rx   d 1 11\n"
    batch, counts = read(b"date Thu Jan 01 10:00:00.500 2026\n" + base + b"\n" + good + b"1.5 " + event + b"\n")
    assert len(batch) == 1
    assert counts.rejected == {LogReject.MALFORMED: 1}
    assert counts.first_rejected == "line 4: malformed"


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
