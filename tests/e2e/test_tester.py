"""The tester against controllers that share no code with ours, as processes on the same bus: scapy's, gallia's."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import ecu_emulator
from ecu_emulator.diagnostics.iso14229 import Status
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


SEEDS = (1, 2, 6, 8)  # of controllers that have a service, have it in another session, have it not at all
PROBED = {"3E", "22", "19"}


def test_controllers_drawn_by_chance_have_what_the_scan_says() -> None:
    place = free_bus()
    bus = ("-i", "udp_multicast", "-c", place.group)
    words = [sys.executable, "-m", "tests.support.uds.gallia_ecu", *bus, *map(str, SEEDS)]
    with pytest.MonkeyPatch.context() as patch:
        for name, value in place.variables.items():
            patch.setenv(name, value)
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
            assert program.stdout is not None
            try:
                has = json.loads(program.stdout.readline())
                last = f"{0x710 + len(SEEDS):X}"
                (record,) = ended(
                    "scan", *bus, *PATIENT, "--first", "70F", "--last", last, "--wait", "0.3", "--json"
                ).records
                assert program.poll() is None
            finally:
                program.kill()
                program.wait(HANG_S)
    found = record["controllers"]
    assert [one["request_id"] for one in found] == [f"{0x710 + place:X}" for place in range(len(SEEDS))]
    for one, sessions in zip(found, has, strict=True):
        everywhere = {f"{service:02X}" for services in sessions.values() for service in services}
        here = {f"{service:02X}" for service in sessions["1"]}
        assert {service["number"] for service in one["services"] if service["there"]} == everywhere & PROBED
        elsewhere = {service["number"] for service in one["services"] if service["remark"].endswith("(7F)")}
        assert elsewhere == (everywhere - here) & PROBED


@contextmanager
def faulty_car(folder: Path, bus: tuple[str, ...]) -> Iterator[None]:
    """Drive one trip, in real time, with a dead pressure sensor; its controller keeps what it knows in a file."""
    scenario, memory = folder / "faulty.toml", folder / "tcu.json"
    healthy = (Path(ecu_emulator.__file__).parent / "scenarios" / "ideal.toml").read_text(encoding="utf-8")
    fault = "\n[[sensor_faults]]\nquantity = 'clutch1_pressure_pa'\nkind = 'not_available'\nstart_s = 1.0\n"
    scenario.write_text(healthy + fault, encoding="utf-8")
    words = [sys.executable, "-m", "ecu_emulator", "run", *bus, "--scenario", str(scenario), "--cycles", "100"]
    words += ["--diagnostics", "--diagnostic-memory", str(memory)]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as program:
        assert program.stderr is not None
        try:
            assert any("sending on" in line for line in program.stderr)
            yield
            program.send_signal(signal.SIGINT)
            assert program.wait(HANG_S) == 0
        finally:
            program.kill()


def asked_until(state: int, bus: tuple[str, ...]) -> int:
    """Return the status of the code of that sensor once all bits of a state are set, as a tester is told."""
    deadline_s = time.monotonic() + HANG_S
    status = 0
    while status & state != state and time.monotonic() < deadline_s:
        (record,) = ended("dtc", *bus, "--active", "--listen", "0.1", "--timeout", "20", "--json").records
        status = next((one["status"] for one in record["codes"] if one["code"] == "P0841"), 0)
    return int(status)


def test_a_code_of_two_trips_is_pending_in_the_first_and_lights_the_lamp_in_the_second(tmp_path: Path) -> None:
    place = free_bus()
    bus = ("-i", "udp_multicast", "-c", place.group)
    lamp = Status.CONFIRMED | Status.WARNING_REQUESTED
    with pytest.MonkeyPatch.context() as patch:
        for name, value in place.variables.items():
            patch.setenv(name, value)
        with faulty_car(tmp_path, bus):
            first = asked_until(Status.TEST_FAILED | Status.PENDING, bus)
        with faulty_car(tmp_path, bus):
            second = asked_until(Status.TEST_FAILED | lamp, bus)
    assert (first & (Status.PENDING | lamp), second & (Status.PENDING | lamp)) == (
        Status.PENDING,
        Status.PENDING | lamp,
    )
