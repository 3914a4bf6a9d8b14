"""Which fluid fills are one, which is meant, and which odometer none can have."""

from datetime import UTC, datetime, timedelta

import pytest

from fleet_contract.orders import (
    FARTHEST_M,
    HIGHEST_M,
    READING_M,
    SAME_WITHIN,
    distinct,
    fill_meant,
    odometer_complaint,
)

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
DAYS = (0.0, 0.9, 1.0, 5.0, 5.5)  # of fills as they were noted
SECOND = timedelta(seconds=1)


def at(days: float) -> datetime:
    return BEGIN + days * SAME_WITHIN


def test_what_was_noted_within_a_day_of_a_fill_is_that_fill() -> None:
    assert distinct(map(at, reversed(DAYS)), lambda moment: moment) == [at(0.0), at(1.0), at(5.0)]


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        (None, at(5.0)),
        (at(0.4), at(0.0)),
        (at(0.6), at(1.0)),  # the nearer of two
        (at(2.0) - SECOND, at(1.0)),
        (at(2.0), None),
        (at(4.0), None),
        (at(4.0) + SECOND, at(5.0)),
        (at(9.0), None),
    ],
)
def test_the_fill_that_is_meant_is_the_nearest_within_a_day(said: datetime | None, meant: datetime | None) -> None:
    assert fill_meant(map(at, DAYS), lambda moment: moment, said) == meant


def test_without_fills_none_is_meant() -> None:
    assert fill_meant((), lambda moment: moment, None) is None


@pytest.mark.parametrize(
    ("odometer_m", "before_m", "after_m", "complaint"),
    [
        (None, 1e8, 1e7, ""),
        (1.95e8, 1.9e8, 2e8, ""),
        (HIGHEST_M, None, None, ""),
        (HIGHEST_M + 1.0, None, None, "no car has driven that far"),
        (2e8 + READING_M, 1.9e8, 2e8, ""),
        (2e8 + READING_M + 1.0, 1.9e8, 2e8, "after that it read 200,000 km; --insist"),
        (2e8 - READING_M, 2e8, None, ""),
        (2e8 - READING_M - 1.0, 2e8, None, "it read 200,000 km before; --insist"),
        (2e8 + FARTHEST_M, 2e8, None, ""),
        (2e8 + FARTHEST_M + 1.0, 2e8, None, "it read 200,000 km before; --insist"),
    ],
)
def test_an_odometer_lies_between_those_beside_it(
    odometer_m: float | None, before_m: float | None, after_m: float | None, complaint: str
) -> None:
    found = odometer_complaint(odometer_m, before_m, after_m)
    assert complaint in found
    assert bool(found) == bool(complaint)
