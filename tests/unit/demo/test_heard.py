"""What the demonstration makes of what a subscriber of MQTT prints, which may be delivered more than once."""

from demo.runner import Heard
from diag_service.diagnosis.records import ShiftResult, shift_record
from tests.support.builders import shift_result


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
