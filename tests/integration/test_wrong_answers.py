"""A controller that answers wrongly: whatever it says, nothing untrue is told."""

from pathlib import Path

import pytest

from tests.integration.test_polling import stopping_when
from tests.support.in_process import ended
from tests.support.uds.wrong_answers import QUESTIONS, told
from tests.support.uds.wrong_ecu import WAYS, Fault, wrong_ecu

# Three ways of being wrong for each question, one after the other: every question and every way is met.
CASES = [(name, list(WAYS)[(3 * at + one) % len(WAYS)]) for at, name in enumerate(QUESTIONS) for one in range(3)]


@pytest.mark.parametrize(("name", "way"), CASES)
def test_nothing_untrue_is_told(name: str, way: str, tmp_path: Path) -> None:
    found = told(name, way, tmp_path)
    assert found.is_true, found


def test_a_scan_changes_no_session() -> None:
    with wrong_ecu("no session") as ecu:
        words = ("-i", "virtual", "-c", "no session", "--listen", "0", "--first", "7E1", "--last", "7E1", "--active")
        assert ended("scan", *words).status == 0
        assert ecu.asked
        assert {request[:2] for request in ecu.asked} <= {"3E", "22", "19"}


def test_polling_tells_nobody_of_a_wrong_answer(tmp_path: Path) -> None:
    words = ("-i", "virtual", "-c", "polled", "--store", tmp_path / "car.sqlite", "--poll", "1", "--active", "--json")
    with (
        wrong_ecu("polled", Fault(request="1902", way=WAYS["head alone"])) as ecu,
        stopping_when(lambda: ecu.asked.count("1902AF") > 1),  # by then the first answer was judged
    ):
        run = ended("run", *words)
    assert run.status == 0, run
    assert [record for record in run.records if record["schema"] == "clutchdiag/controller/v1"] == []
    assert "the trouble codes were not read: 7E1 (answers 7E9) answers 19 02 AF with 59 02" in run.err
