"""A controller that answers wrongly: whatever it says, nothing untrue is told."""

from pathlib import Path
from typing import Any

import can
import pytest

from diag_service.errors import ControllerError
from diag_service.tester.scanning import find_addresses
from tests.integration.test_polling import stopping_when
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.uds.wrong_answers import QUESTIONS, told
from tests.support.uds.wrong_ecu import WAYS, Fault, wrong_ecu

# Three ways of being wrong for each question, one after the other: every question and every way is met.
CASES = [(name, list(WAYS)[(3 * at + one) % len(WAYS)]) for at, name in enumerate(QUESTIONS) for one in range(3)]


@pytest.mark.parametrize(("name", "way"), CASES)
def test_nothing_untrue_is_told(name: str, way: str, tmp_path: Path) -> None:
    found = told(name, way, tmp_path)
    assert found.is_true, found


def test_ctrl_c_ends_a_wait_for_a_controller_that_asks_for_time() -> None:
    pending = Fault(request="1902", way=lambda _, __: [b"\x03\x7f\x19\x78"])
    with wrong_ecu("ctrl-c", pending) as ecu, stopping_when(lambda: "1902AF" in ecu.asked):
        run = ended("dtc", "-i", "virtual", "-c", "ctrl-c", "--listen", "0", "--active")
    assert (run.status, run.out) == (130, "")
    assert "stopped early: not everything was asked" in run.err


def test_a_scan_changes_no_session() -> None:
    with wrong_ecu("no session") as ecu:
        words = ("-i", "virtual", "-c", "no session", "--listen", "0", "--first", "7E1", "--last", "7E1", "--active")
        assert ended("scan", *words).status == 0
        assert ecu.asked
        assert {request[:2] for request in ecu.asked} <= {"3E", "22", "19"}


def test_a_scan_gives_way_to_another_tester() -> None:
    with can.Bus("gives way", "virtual") as other, can.Bus("gives way", "virtual") as bus:
        other.send(can.Message(arbitration_id=0x7E0, is_extended_id=False, data=b"\x02\x3e\x80"))
        with pytest.raises(ControllerError, match=r"another tester began to ask on this bus \(requests on 7E0\)"):
            find_addresses(bus, [0x7E5], frozenset(), wait_s=HANG_S)


def told_of(*words: str) -> list[dict[str, Any]]:
    with wrong_ecu("readiness"):
        run = ended("dtc", "-i", "virtual", "-c", "readiness", "--listen", "0", "--active", "--json", *words)
    assert run.status == 0, run
    codes: list[dict[str, Any]] = run.records[0]["codes"]
    return codes


def test_codes_of_a_readiness_group_and_their_performance_are_told() -> None:
    (code,) = told_of("--readiness", "01", "--brief")
    assert (code["code"], code["status"]) == ("P0811", 0x2F)
    (code,) = told_of("--record", "91")
    assert code["extended_data"] == [
        {
            "number": 0x91,
            "data": {"in-use performance of the monitor": {"completed": 5, "conditions met": 16}},
            "rest": "",
        }
    ]


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
