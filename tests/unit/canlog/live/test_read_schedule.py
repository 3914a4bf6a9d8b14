"""How long frames gather: nobody hurries until something can come of it."""

import pytest

from canlog.live.sources import EXPECTING_S, LATE_S, NS_PER_S, URGENT_S, ReadSchedule
from diag_service.diagnosis.shifts.shifts import POST_NS

NOW_NS = 1_700_000_000_000_000_000


def waiting(*, due_ns: int | None = None) -> ReadSchedule:
    schedule = ReadSchedule()
    schedule.wait_for(is_expecting=True, due_ns=due_ns)
    return schedule


def test_the_end_of_a_shift_is_known_before_its_result_is_due() -> None:
    assert waiting().gather_s(NOW_NS) == EXPECTING_S <= POST_NS / NS_PER_S


@pytest.mark.parametrize(
    ("ahead_s", "expected_s"), [(0.04, 0.04 + LATE_S), (0.0, URGENT_S), (-1.0, URGENT_S), (9.0, EXPECTING_S)]
)
def test_frames_are_looked_at_just_when_a_result_is_due(ahead_s: float, expected_s: float) -> None:
    schedule = waiting(due_ns=NOW_NS + round(ahead_s * NS_PER_S))
    assert schedule.gather_s(NOW_NS) == pytest.approx(expected_s)
