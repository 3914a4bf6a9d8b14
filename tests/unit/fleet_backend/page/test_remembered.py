"""Pasts are kept while nothing new is stored, in bounded memory, and not for ever."""

from fleet_backend.page.remembered import LONGEST_S, Past, Remembered
from fleet_backend.page.vehicle_view import point_of
from tests.support.fleet import row_of
from tests.support.histories import history

POINT = point_of(row_of(history(1)[0]) | {"stored_at": None})


class Maker:
    """Makes pasts, and counts them."""

    def __init__(self, length: int = 1) -> None:
        self.count = 0
        self._length = length

    def __call__(self) -> Past:
        self.count += 1
        return Past(trend=(POINT,) * self._length, outlook=None, why_no_outlook="none")


def test_a_past_is_made_once_for_each_state() -> None:
    remembered, make = Remembered(), Maker()
    first = remembered.past("a", 1, make)
    assert remembered.past("a", 1, make) is first
    assert remembered.past("b", 1, make) is not first
    assert remembered.past("a", 2, make) is not first
    assert make.count == 3


def test_what_nobody_asked_for_longest_goes_first_and_all_goes_in_time() -> None:
    now_s = 0.0
    remembered, make = Remembered(most_points=5, clock=lambda: now_s), Maker(2)
    for key in ("a", "b", "a", "c"):
        remembered.past(key, 0, make)
    assert make.count == 3
    remembered.past("a", 0, make)
    assert make.count == 3
    remembered.past("b", 0, make)
    assert make.count == 4
    now_s = LONGEST_S
    remembered.past("b", 0, make)
    assert make.count == 5


def test_one_past_is_kept_however_long_it_is() -> None:
    remembered, make = Remembered(most_points=1), Maker(7)
    assert remembered.past("a", 0, make) is remembered.past("a", 0, make)
    assert make.count == 1
