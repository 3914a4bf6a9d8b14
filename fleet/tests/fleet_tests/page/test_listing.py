"""The fleet in parts: the worst first, nothing left out and nothing twice, whatever a reader puts into an address."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_backend.errors import NotFoundError
from fleet_backend.page.listing import cursor, part_of, place_of, read_words, worst_first
from fleet_backend.page.records import ClutchNow
from tests.support.fleet_page import clutch_now

KINDS = (int, float, float, str, int)
CONDITIONS = ("change_fluid", "watch", "good", "no_verdict")
CLUTCHES = st.builds(
    clutch_now,
    st.sampled_from(["car1", "car2", "Taxi.7", "_9"]),
    st.sampled_from([1, 2]),
    condition=st.sampled_from(CONDITIONS),
    probability_negative_slope=st.none() | st.floats(0.0, 1.0),
    level_ratio=st.none() | st.floats(0.1, 1.5),
)
FLEETS = st.lists(CLUTCHES, max_size=30, unique_by=lambda one: (one.vehicle, one.clutch))


@given(FLEETS, st.integers(1, 7))
def test_parts_are_the_whole(fleet: list[ClutchNow], limit: int) -> None:
    whole = worst_first(fleet)
    after, found = None, list[ClutchNow]()
    for _ in range(len(whole) + 1):
        part = part_of(whole, after, limit)
        assert part.matching_count == len(whole)
        found += part.clutches
        after = part.next
        if after is None:
            break
    assert tuple(found) == whole


def test_a_list_goes_on_where_the_last_clutch_has_gone() -> None:
    fleet = worst_first([clutch_now(name) for name in ("a", "b", "c")])
    part = part_of(fleet, None, 2)
    (rest,) = part_of(fleet[:1] + fleet[2:], part.next, 2).clutches
    assert rest.vehicle == "c"


@given(CLUTCHES)
def test_a_place_survives_an_address(one: ClutchNow) -> None:
    assert tuple(read_words(cursor(place_of(one)), KINDS)) == place_of(one)


STRANGE = (
    cursor([1]),
    cursor(["a"] * 5),
    cursor([1, 2, 3, "a", True]),
    cursor([1, 2.0, 10**400, "a", 1]),
    "W10",
    "ICAg",
)


@given(st.text(max_size=80) | st.sampled_from(STRANGE))
def test_nothing_else_is_taken_for_a_place(word: str) -> None:
    with pytest.raises(NotFoundError, match="not a position in a list"):
        part_of([clutch_now("a")], word, 1)
