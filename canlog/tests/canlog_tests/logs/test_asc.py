"""Vector ASC logs: events and dates."""

from datetime import datetime

import pytest

from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs.asc import AscLog
from canlog.logs.dates import date_us
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


def local_us(*parts: int) -> int:
    return int(datetime(*parts).timestamp()) * 10**6  # type: ignore[arg-type]  # noqa: DTZ001 - local, as in the format


@pytest.mark.parametrize(
    ("text", "hour", "milliseconds"),
    [
        (b"Thu Jan 01 10:00:00.005 2026", 10, 5),
        (b"Thu Jan 01 10:00:00.5 2026", 10, 5),  # as python-can writes five milliseconds
        (b"Thu Jan 1 10:00:00 2026", 10, 0),
        (b"Thu Jan 01 10:00:00.005000 2026", 10, 5),  # six digits are a fraction
        (b"Thu Jan  1 10:00:00.123 pm 2026", 22, 123),
        (b"Thu Jan 1 12:00:00.000 am 2026", 0, 0),
        (b"Thu Jan 1 09:00:00 PM 2026", 21, 0),
        (b"Thu Jan 1 21:00:00 pm 2026", 21, 0),
        (b"Thu Jan 1 9:00:00 p.m. 2026", 21, 0),
        (b"Thu Jan 01 10:00:00 am 2026 // version 9", 10, 0),
        (b"Don Jan 01 10:00:00.000 2026", 10, 0),
        (b"jeu. 1 janv. 2026 10:00:00.250", 10, 250),
        ("Čt led 1 10:00:00.000 2026".encode(), 10, 0),
        ("чт янв 01 10:00:00.005 2026".encode(), 10, 5),
        ("木 1月 01 10:00:00.005 2026".encode(), 10, 5),
        ("2026年1月1日 10:00:00".encode(), 10, 0),
        (b"1:1:2026 10:00:00:250", 10, 250),  # as BUSMASTER writes dates: day, month
        (b"01.01.2026 10:00:00.250", 10, 250),
        (b"2026-01-01 10:00:00.250", 10, 250),
        (b"2026-01-01T10:00:00.250", 10, 250),
        (b"2026/1/1 10:00:00", 10, 0),
        (b"1/1/2026 10:00:00 PM", 22, 0),  # the same day in either order
        (b"jue. ene. 1 10:00:00.005 p. m. 2026", 22, 5),
        (b"Do Jan 01 10:00:00.005 nachm. 2026", 22, 5),
        (b"Do Jan 01 10:00:00.005 vorm. 2026", 10, 5),
        ("周四 1月 01 10:00:00.005 下午 2026".encode(), 22, 5),
        ("周四 1月 01 上午 10:00:00.005 2026".encode(), 10, 5),
        ("木 1月 01 10:00:00.005 午後 2026".encode(), 22, 5),
    ],
)
def test_times(text: bytes, hour: int, milliseconds: int) -> None:
    assert date_us(text) == local_us(2026, 1, 1, hour) + milliseconds * 1000


@pytest.mark.parametrize(
    ("names", "language"),
    [
        ("Jan Feb Mrz Apr Mai Jun Jul Aug Sep Okt Nov Dez", "German"),
        ("Jan. Feb. März April Mai Jun. Jul. August September Okt. November Dez.", "German"),
        ("janv. févr. mars avr. mai juin juil. août sept. oct. nov. déc.", "French"),
        ("ene feb mar abr may jun jul ago sep oct nov dic", "Spanish"),
        ("gen feb mar apr mag giu lug ago set ott nov dic", "Italian"),
        ("jan fev mar abr mai jun jul ago set out nov dez", "Portuguese"),
        ("jan feb mrt apr mei jun jul aug sep okt nov dec", "Dutch"),
        ("jan feb mar apr maj jun jul aug sep okt nov dec", "Swedish, Danish"),
        ("jan feb mar apr mai jun jul aug sep okt nov des", "Norwegian"),
        ("tammi helmi maalis huhti touko kesä heinä elo syys loka marras joulu", "Finnish"),
        ("sty lut mar kwi maj cze lip sie wrz paź lis gru", "Polish"),  # codespell:ignore
        ("led úno bře dub kvě čvn čvc srp zář říj lis pro", "Czech"),
        ("oca şub mar nis may haz tem ağu eyl eki kas ara", "Turkish"),
        ("jan. febr. márc. ápr. máj. jún. júl. aug. szept. okt. nov. dec.", "Hungarian"),
        ("ian feb mar apr mai iun iul aug sep oct noi dec", "Romanian"),
        ("янв фев мар апр май июн июл авг сен окт ноя дек", "Russian"),
    ],
)
def test_months_of_many_languages(names: str, language: str) -> None:
    found = [date_us(f"Xyz {name} 05 10:00:00.000 2026".encode()) for name in names.split()]
    assert found == [local_us(2026, month, 5, 10) for month in range(1, 13)], language


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"yesterday",
        b"Thu Foo 01 10:00:00 2026",
        b"Thu Feb 30 10:00:00 2026",
        b"Thu Jan 01 25:00:00 2026",
        b"Thu Jan 01 13:00:00 am 2026",
        b"Thu Jan 01 10:00:00.123 0006",
        b"Thu Jan 01 00:00:00 0001",
        b"Thu Jan 01 2026",
        b"03/04/2026 10:00:00",  # March or April
        b"Thu Jan 01 10:00:00 CEST 2026",  # a zone that is not known
        b"%s/%s" % (b"\xff" * 40, b"1" * 4000),
    ],
)
def test_a_date_that_is_not_understood_is_none(text: bytes) -> None:
    assert date_us(text) is None
