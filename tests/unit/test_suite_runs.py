"""The table of several runs of the suite: host and guest together, and what failed."""

import argparse

import pytest

from tests.tools.suite_runs import Asked, asked_for, run_of, table

SAID = """\
test: on this machine, Linux 6.18
order: --order-seed 13
FAILED tests/unit/test_a.py::test_one - assert 1 == 2
ERROR tests/unit/test_a.py::test_two - OSError
====== 1 failed, 8600 passed, 160 deselected, 1 error in 712.33s (0:11:52) ======
test: on a real vcan
=============== 160 passed, 8602 deselected in 201.10s (0:03:21) ===============
"""


def test_host_and_guest_count_together() -> None:
    run = run_of(asked_for("13:busy"), SAID, status=2, minutes=11.9)
    assert (run.collected, run.passed, run.failed) == (8762, 8760, 2)
    assert table([run]).splitlines()[2:] == [
        "| 13 | busy | 8762 | 8760 | 2 | 11.9 | 2 |",
        "| all | | 8762 | 8760 | 2 | 11.9 | |",
        "",
        "- order 13, busy: FAILED tests/unit/test_a.py::test_one - assert 1 == 2",
        "- order 13, busy: ERROR tests/unit/test_a.py::test_two - OSError",
    ]


def test_a_run_that_said_nothing_passed_nothing() -> None:
    run = run_of(asked_for("13"), "make: *** no rule\n", status=2, minutes=0.0)
    assert (run.collected, run.passed, run.failed, run.status) == (0, 0, 0, 2)


@pytest.mark.parametrize(
    ("text", "condition", "is_on_one_core", "is_beside_loops"),
    [("7", "idle", False, False), ("7:one-core", "one-core", True, False), ("7:busy", "busy", False, True)],
)
def test_a_run_is_a_number_and_what_it_is_run_under(
    text: str, condition: str, *, is_on_one_core: bool, is_beside_loops: bool
) -> None:
    asked = asked_for(text)
    assert asked == Asked(seed=7, condition=condition)
    assert (asked.is_on_one_core, asked.is_beside_loops) == (is_on_one_core, is_beside_loops)


@pytest.mark.parametrize("text", ["busy", "7:quick", ""])
def test_any_other_word_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="one of idle, one-core"):
        asked_for(text)
