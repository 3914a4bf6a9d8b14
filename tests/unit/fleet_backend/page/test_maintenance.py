"""What is due: in the order of its days, what is overdue first."""

from datetime import UTC, datetime, timedelta

from fleet_backend.page.maintenance_view import driven_a_day_m


def test_how_much_a_vehicle_is_driven_is_counted_over_the_last_months() -> None:
    start = datetime(2026, 1, 1, tzinfo=UTC)
    cases: tuple[tuple[tuple[tuple[float, float | None], ...], float | None], ...] = (
        (((0.0, 0.0), (10.0, 5.0e5)), 5.0e4),
        (((-900.0, 0.0), (0.0, 9.0e7), (10.0, 9.02e7)), 2.0e4),
        (((0.0, 0.0), (5.0, None), (10.0, 5.0e5), (11.0, None)), 5.0e4),
        (((0.0, 0.0), (0.5, 5.0e5)), None),
        (((0.0, 5.0e5), (9.0, 5.0e5)), None),
        (((0.0, None),), None),
        (((-20450.0, 0.0), (-20440.0, 5.0e5)), None),  # of 1970: the clock was not set
        (((0.0, 0.0), (10.0, 5.0e5), (-20440.0, 6.0e5)), 5.0e4),
        ((), None),
    )
    for seen, wanted in cases:
        assert driven_a_day_m((start + timedelta(days=days), m) for days, m in seen) == wanted
