"""The tester against a controller that shares no code with ours, as a process on the same bus: scapy's."""

import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.replay import free_bus

ANSWERS = ("--ecu", "742", "--reply", "75A")
PATIENT = ("--active", "--listen", "0.1", "--timeout", "20")


@pytest.fixture(name="foreign", scope="module")
def _foreign() -> Iterator[tuple[str, ...]]:
    """Start the controller; it is asked three things and must be there in the end."""
    place = free_bus()
    bus = ("-i", "udp_multicast", "-c", place.group)
    words = [sys.executable, "-m", "tests.support.uds.scapy_ecu", *bus]
    with pytest.MonkeyPatch.context() as patch:
        for name, value in place.variables.items():
            patch.setenv(name, value)
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
            assert program.stdout is not None
            try:
                assert program.stdout.readline() == "answering\n"
                yield bus
                assert program.poll() is None  # whatever it was asked, it lives
            finally:
                program.kill()
                program.wait(HANG_S)


def test_it_is_found_where_nobody_would_look_for_it(foreign: tuple[str, ...]) -> None:
    (record,) = ended("scan", *foreign, *PATIENT, "--first", "741", "--last", "743", "--wait", "0.3", "--json").records
    (found,) = record["controllers"]
    assert (found["request_id"], found["response_id"], found["trouble_codes"]) == ("742", "75A", 2)
    assert [one["there"] for one in found["services"]] == [True] * 3
    assert {one["number"]: one["values"] for one in found["data"]} == {
        "F190": {"vehicle identification number": "WFOREIGN000000001"},
        "F18C": {"serial number": "A SERIAL NUMBER THAT TAKES SOME FRAMES"},
    }


def test_its_codes_are_told_and_what_is_not_described_stays_bytes(foreign: tuple[str, ...]) -> None:
    (record,) = ended("dtc", *foreign, *PATIENT, *ANSWERS, "--json").records
    assert [(one["code"], one["failure_type"], one["text"]) for one in record["codes"]] == [
        ("P0123", 0x45, ""),
        ("B1ABC", 0xDE, ""),
    ]
    assert record["codes"][0]["snapshots"] == [{"number": 1, "data": {}, "rest": "12 34 AA BB"}]
    assert record["description"] == "a controller without description"


def test_what_it_refuses_is_told(foreign: tuple[str, ...]) -> None:
    refused = ended("routine", "0201", "results", *foreign, *PATIENT, *ANSWERS, "--session", "01")
    refused.assert_one_line(3, "742 (answers 75A) refuses 31 03 02 01: general reject (10)")
