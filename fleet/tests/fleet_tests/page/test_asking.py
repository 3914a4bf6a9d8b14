"""Words of an address: each is checked once, and what is wrong is said in one line."""

from datetime import UTC, datetime

import pytest

from fleet_backend.errors import AskError
from fleet_backend.page.asking import AFTER, LIMIT, VEHICLE, Ask, Parameter, ParameterType, read_words
from tests.support.fleet import NOW

SINCE = Parameter(name="since", text="since when", kind=ParameterType.MOMENT, longest=40)
COLOUR = Parameter(name="colour", text="of it", choices=("red", "blue"))
ALL = (VEHICLE, LIMIT, AFTER, SINCE, COLOUR)


def ask(*query: tuple[str, str], vehicle: str = "car1") -> Ask:
    return read_words(ALL, {"vehicle": vehicle}, query, NOW)


def test_words_become_values() -> None:
    found = ask(("limit", "7"), ("since", "2026-01-31"), ("colour", "red"), ("after", ""))
    assert (found.said("vehicle"), found.count("limit"), found.text("colour")) == ("car1", 7, "red")
    assert found.moment("since", NOW) == datetime(2026, 1, 31, tzinfo=UTC)
    assert found.text("after") is None
    assert ask().count("limit") == 50
    assert ask().moment("since", NOW) == NOW
    assert ask(("since", "2026-01-31T12:00:00+02:00")).moment("since", NOW).hour == 10


@pytest.mark.parametrize(
    ("query", "complaint"),
    [
        ([("limit", "0")], "limit: must be a whole number from 1 to 1000"),
        ([("limit", "-1")], "limit: must be a whole number"),
        ([("limit", "١٢")], "limit: must be a whole number"),
        ([("since", "yesterday")], "since: no date, such as 2026-01-31"),
        ([("colour", "green")], "colour: must be one of red, blue"),
        ([("colour", "red"), ("colour", "blue")], "'colour': given twice"),
        ([("vehicle", "car2")], "'vehicle': given twice"),
        ([("color", "red")], "'color': not a parameter of this address; it takes after, colour, limit, since, vehicle"),
        ([("after", "x" * 401)], "after: longer than 400 characters"),
        ([("after", "a\x00")], "after: holds characters that are not text"),
        ([("after", "a\u202eb")], "after: holds characters that are not text"),
        ([("after", "a b")], "after: is none"),
    ],
)
def test_what_is_wrong_is_said(query: list[tuple[str, str]], complaint: str) -> None:
    with pytest.raises(AskError) as caught:
        ask(*query)
    assert str(caught.value).startswith(complaint)
