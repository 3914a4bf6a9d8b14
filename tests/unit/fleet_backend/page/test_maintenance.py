"""What is due: in the order of its days, what is overdue first."""

from datetime import date

from fleet_backend.page.maintenance_view import by_day
from fleet_backend.page.records import Due


def due(vehicle: str, day: date | None, *, is_overdue: bool = False) -> Due:
    return Due(
        vehicle=vehicle,
        clutch=1,
        condition="good",
        is_overdue=is_overdue,
        due_from=day,
        half_by=day,
        most_by=day,
        distance_a_day_m=None,
        text="",
    )


def test_the_next_day_comes_first_and_what_has_none_last() -> None:
    some = (due("none", None), due("late", date(2026, 5, 1)), due("soon", date(2026, 2, 1)))
    overdue = due("overdue", date(2026, 3, 1), is_overdue=True)
    assert [one.vehicle for one in by_day((*some, overdue))] == ["overdue", "soon", "late", "none"]
