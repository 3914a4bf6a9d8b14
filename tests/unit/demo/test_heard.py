"""What the demonstration makes of what a subscriber of MQTT prints, which may be delivered more than once."""

import pytest

from demo.runner import Heard
from diag_service.diagnosis.records import ServiceStatus, ShiftResult, shift_record, status_record
from diag_service.errors import ResultError
from tests.support.builders import shift_result


def status(*, is_online: bool) -> dict[str, object]:
    return status_record(
        ServiceStatus(
            vehicle="car1",
            is_online=is_online,
            connected_at="2026-01-01T00:00:00.000000Z",
            service_version="1",
            algorithm_version="1",
            calibration_version="1",
        )
    )


def heard(*records: dict[str, object]) -> tuple[Heard, list[ShiftResult]]:
    shown: list[ShiftResult] = []
    found = Heard(shown.append)
    for record in records:
        found.take(record)
    return found, shown


def test_shifts_are_shown_once_and_as_they_come() -> None:
    found, shown = heard(*(shift_record(shift_result(seq)) for seq in (2, 1, 2)))
    assert [result.seq for result in shown] == [2, 1]
    assert sorted(found.shifts) == [1, 2]


async def test_the_service_is_online_while_it_says_so() -> None:
    online, gone = status(is_online=True), status(is_online=False)
    assert [heard(*told)[0].is_online for told in ((online,), (online, gone), ())] == [True, False, False]
    assert not await heard()[0].within(0.01, lambda: False)


def test_a_foreign_shift_is_an_error() -> None:
    with pytest.raises(ResultError):
        heard({**shift_record(shift_result(1)), "verdict": None})
