"""The dates of ASC files, in the languages and orders in which programs write them."""

from datetime import datetime

import pytest

from canlog.logs.dates import date_us


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
