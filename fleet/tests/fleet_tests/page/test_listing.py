"""The fleet in parts: the worst first, nothing left out and nothing twice, whatever a reader puts into an address."""

from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_backend.errors import NotFoundError
from fleet_backend.page.fleet import place_of
from fleet_backend.page.parts import part_of, read_place, word_of
from fleet_backend.page.questions import ORDERS
from fleet_backend.page.records import ClutchNow
from tests.support.fleet import NOW
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
    odometer_m=st.none() | st.floats(0.0, 1e9),
    fluid=st.none() | st.sampled_from(["DCTF", "other"]),
)
FLEETS = st.lists(CLUTCHES, max_size=30, unique_by=lambda one: (one.vehicle, one.clutch))


@given(FLEETS, st.sampled_from([None, *ORDERS]), st.integers(1, 7), st.booleans())
def test_parts_are_the_whole(fleet: list[ClutchNow], order: str | None, limit: int, is_down: bool) -> None:
    def place(one: ClutchNow) -> tuple[object, ...]:
        return place_of(one) if order is None else (ORDERS[order](one), one.vehicle, one.clutch)

    whole = sorted(fleet, key=place)
    after, found = None, list[ClutchNow]()
    for _ in range(len(whole) + 1):
        part, after = part_of(whole, place, after, limit, is_down=is_down)
        found += part
        if after is None:
            break
    assert found == (whole[::-1] if is_down else whole)


def test_a_list_goes_on_where_the_last_clutch_has_gone() -> None:
    fleet = sorted((clutch_now(name) for name in ("a", "b", "c")), key=place_of)
    _, after = part_of(fleet, place_of, None, 2)
    (rest,), _ = part_of(fleet[:1] + fleet[2:], place_of, after, 2)
    assert rest.vehicle == "c"


@given(CLUTCHES)
def test_a_place_survives_an_address(one: ClutchNow) -> None:
    assert read_place(str(word_of(place_of(one))), KINDS) == place_of(one)
    assert read_place(str(word_of([NOW, "a"])), (datetime, str)) == (NOW, "a")


STRANGE = (*(str(word_of(one)) for one in ([1], ["a"] * 5, [1, 2, 3, "a", True])), "W10", "ICAg")


@given(st.text(max_size=80) | st.sampled_from(STRANGE))
def test_nothing_else_is_taken_for_a_place(word: str) -> None:
    with pytest.raises(NotFoundError, match="not a position in a list"):
        part_of([clutch_now("a")], place_of, word, 1)
