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


@pytest.mark.parametrize("kind", [b"absolute", b"relative"])
def test_a_time_beyond_what_can_be_told_is_no_frame(kind: bytes) -> None:
    lines = b"1.0 1 A0 Rx d 0\n" + b"9999999999.0 1 A0 Rx d 0\n" * 1_000
    batch, counts = read(b"date Thu Jan 01 10:00:00.500 2026\nbase hex timestamps %s\n%s" % (kind, lines))
    assert (batch.t_ns - START_NS).tolist() == [1_000_000_000]
    assert counts.rejected == {LogReject.MALFORMED: 1_000}


def test_decimal_base() -> None:
    batch, counts = read(b"base dec timestamps absolute\n1.0 1 160 Rx d 3 10 255 7\n1.1 1 A0 Rx d 0\n")
    assert batch.can_id.tolist() == [160]
    assert batch.data[0, :3].tolist() == [10, 255, 7]
    assert counts.rejected == {LogReject.MALFORMED: 1}


@pytest.mark.parametrize("missing", range(2, 36))
def test_a_frame_cut_off_by_the_end_is_counted(missing: int) -> None:
    whole = b"1.0 1  A0  Rx   d 8 11 22 33 44 55 66 77 88\n"
    batch, counts = read(HEADER + whole + whole[:-missing])
    assert len(batch) == 1
    assert counts.truncated
    assert counts.rejected == {LogReject.CUT_OFF: 1}


def test_a_last_line_without_newline_counts_if_nothing_can_be_missing() -> None:
    batch, counts = read(HEADER + b"1.0 1  A0  Rx   d 2 11 22")
    assert batch.length.tolist() == [2]
    assert counts == LogCounts(frames=1, skipped=3)


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


def test_the_numbers_behind_a_payload_are_no_bytes_of_it() -> None:
    batch, counts = read(HEADER + b"1.0 CANFD 1 Rx 123 0 0 2 2 01 0 0 1000 0 0 0 0 0\n")
    assert len(batch) == 0
    assert counts.rejected == {LogReject.MALFORMED: 1}


@pytest.mark.parametrize("comment", [b" // slip", b"  //slip = 5", b"\t// Rx d 8", b" // c"])
@pytest.mark.parametrize(
    ("event", "length"),
    [
        (b"1  123  Rx   d 2 01 02", 2),
        (b"1  123  Rx   d 0", 0),
        (b"1  123  Rx   d 9 01 02 03 04 05 06 07 08", 8),  # a code above eight means eight bytes
        (b"1  123  Rx   d 02 01 02", 2),
        (b"1  123  Rx   r 2", 2),
        (b"CANFD 1 Rx 123 0 0 2 2 01 02 0 0 1000 0 0 0 0 0", 2),
        (b"CANFD 1 Rx 123 Name 0 0 2 2 01 02", 2),
        (b"CANFD 1 Rx 123 Name 0 0 2 2 01 02 0", 2),  # behind which a comment of one letter is no flags
    ],
)
def test_a_trailing_comment_changes_nothing(event: bytes, length: int, comment: bytes) -> None:
    batch, counts = read(HEADER + b"1.0 " + event + comment + b"\n1.0 " + event + b"\n")
    assert batch.length.tolist() == [length, length]
    assert batch.flags[0] == batch.flags[1]
    assert counts == LogCounts(frames=2, skipped=3)


def test_a_remote_frame_of_a_fd_line_has_the_length_of_its_code() -> None:
    batch, _ = read(HEADER + b"1.0 CANFD 1 Tx 123 0 0 8 0 0 0 10 0 0 0 0 0\n")
    assert (batch.can_id.tolist(), batch.length.tolist()) == ([0x123 | REMOTE_FLAG], [8])


def test_a_date_that_is_not_understood_is_said_once() -> None:
    frame = b"1.0 1 123 Rx d 0\n"
    text = b"date Thu Foo 01 10:00:00 2026\nbase hex\nBegin Triggerblock Thu Foo 01 10:00:00 2026\n" + frame
    batch, counts = read(text)
    assert batch.t_ns.tolist() == [1_000_000_000]
    assert counts.notes == ("the date 'Thu Foo 01 10:00:00 2026' is not understood: times count from 1970",)


def test_a_date_that_is_understood_stays_where_a_later_one_is_not() -> None:
    batch, counts = read(HEADER + b"Begin Triggerblock someday\n1.0 1 123 Rx d 0\n")
    assert batch.t_ns.tolist() == [START_NS + 1_000_000_000]
    assert not counts.notes


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


@pytest.mark.parametrize("code", [b"9", b"f", b"d"])
def test_a_classic_frame_has_eight_bytes_whatever_its_code(code: bytes) -> None:
    batch, counts = read(HEADER + b"1.0 1 100 Rx d " + code + b" 11 22 33 44 55 66 77 88\n")
    assert (batch.length.tolist(), batch.flags.tolist(), counts.rejected) == ([8], [0], {})


@pytest.mark.parametrize("name", [b"2ndGear", b"1_Name", b"0x1", b"10"])
def test_the_name_of_a_message_may_begin_with_a_digit(name: bytes) -> None:
    batch, counts = read(HEADER + b"1.0 CANFD 1 Rx 123 " + name + b" 1 0 2 2 11 22 0 0 1000 0 0 0 0 0\n")
    assert (batch.length.tolist(), batch.can_id.tolist(), counts.rejected) == ([2], [0x123], {})


@pytest.mark.parametrize(
    "event",
    [
        b"?  A0  Rx d 2 11 22",
        b"-1  A0  Rx d 2 11 22",
        b"can0  18FEF100x  Tx d 2 11 22",
        b"None  A0  Rx r",
        b"CANFD   ?  Rx  123  1 0 2 2 11 22 0 0 1000 0 0 0 0 0",
        b"CANFD  can1  Tx  123  Name 1 0 2 2 11 22 0 0 1000 0 0 0 0 0",
    ],
)
def test_a_frame_of_a_channel_that_is_none_is_counted(event: bytes) -> None:
    batch, counts = read(HEADER + b"   1.000002 " + event + b"\n")
    assert len(batch) == 0
    assert counts.rejected == {LogReject.MALFORMED: 1}
    assert counts.first_rejected == "line 4: malformed"


@pytest.mark.parametrize(
    "event",
    [
        b"1  J1939TP FEE3p 6 0 0 - Rx d 39 45 00 20 4E",
        b"Li 1  Rx 3c 8 01 02 03 04 05 06 07 08",
        b"ETH 1 Rx 5a:0102",
        b"CANFD   Start of measurement",
        b"CAN 1 Status:chip status error active - TxErr: 8 RxErr: 0",
    ],
)
def test_events_of_other_buses_stay_skipped(event: bytes) -> None:
    batch, counts = read(HEADER + b"   1.000002 " + event + b"\n")
    assert len(batch) == 0
    assert counts == LogCounts(skipped=4)
