"""The tester against our controller on a virtual bus: listens first, asks only if told to, decodes what it hears."""

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import can
import pytest

from tests.support.doip.tester import entity
from tests.support.in_process import ended
from tests.support.uds.wire import parked_controller
from workshop.controller.controller import Controller
from workshop.controller.link import DiagnosticLink
from workshop.controller.memory import TestResult as Result

CHANNEL = "tester"
PATIENT = ("--listen", "0.05", "--timeout", "20")  # only a hang takes so long
BUS = ("-i", "virtual", "-c", CHANNEL, *PATIENT)
LONG = ("--listen", "0.6")  # in which even a busy machine lets others speak
WAIT = ("--wait", "0.15")  # a busy machine may answer later: then the scan finds out by asking again
BUSY_ID = 0x7EA
SLIPS = 0x081107
SUMP = 0x02184B
CLEARED = 0x50  # not tested since the clear, nor in this cycle
MASK = "5AA5C33C"


class Vehicle:
    """A bus on which controllers talk whether they are asked or not; it keeps what else it hears."""

    def __init__(self, channel: str, *links: DiagnosticLink, near: can.BusABC) -> None:
        self.heard: list[int] = []
        self._near = near
        self._links = links
        self._channel = channel
        self._is_over = threading.Event()
        self._talk = threading.Thread(target=self._run, daemon=True)
        self._talk.start()

    def hear(self, message: can.Message) -> None:
        self.heard.append(message.arbitration_id)
        for link in self._links:
            link.feed(message)

    def end(self) -> None:
        self._is_over.set()
        self._talk.join()

    def _run(self) -> None:
        while not self._is_over.wait(0.02):
            self._near.send(can.Message(arbitration_id=0x0A0, is_extended_id=False, data=bytes(8)))
            self._near.send(can.Message(arbitration_id=BUSY_ID, is_extended_id=False, data=b"\x02\x7e\x00"))


@contextmanager
def vehicle(channel: str, *controllers: Controller, is_fd: bool = False) -> Iterator[Vehicle]:
    with can.Bus(channel, "virtual", fd=is_fd) as near, ExitStack() as stack:
        links = [stack.enter_context(DiagnosticLink(one, near.send, is_fd=is_fd)) for one in controllers]
        bus = Vehicle(channel, *links, near=near)
        stack.callback(bus.end)
        stack.enter_context(can.Notifier(near, [bus.hear], timeout=0.05))
        yield bus


def slipping() -> Controller:
    """Return a controller that has found that a clutch slips."""
    controller = parked_controller()
    for _ in range(20):
        controller.report(SLIPS, Result.FAILED)
    return controller


controller = pytest.fixture(scope="module")(slipping)


@pytest.fixture(scope="module")
def car(controller: Controller) -> Iterator[Vehicle]:
    with vehicle(CHANNEL, controller) as car:
        yield car


def told(*words: str | Path) -> dict[str, Any]:
    """Return the JSON of a command that went well."""
    done = ended(*words, "--json")
    assert done.status == 0, done
    (record,) = done.records
    return record


@pytest.mark.parametrize("channel", [("-c", "no_can99"), ()], ids=["no interface", "no name"])
@pytest.mark.parametrize("command", [("try",), ("dtc",), ("did", "F190"), ("scan",), ("routine", "0302", "start")])
def test_a_bus_that_cannot_be_opened_is_told_as_the_service_tells_it(
    command: tuple[str, ...], channel: tuple[str, ...]
) -> None:
    where = ("-i", "socketcan", *channel)
    run, served = ended(*command, *where), ended("monitor", *where)
    assert (run.status, run.err.splitlines()[-1]) == (3, served.err.splitlines()[-1])


def test_without_leave_a_bus_is_listened_to_only(car: Vehicle) -> None:
    car.heard.clear()
    words = (["dtc"], ["did", "F190"], ["routine", "0302", "start"], ["scan", "--first", "7E0"])
    for command in words:
        record = told(*command, *BUS)
        assert record["asked"] is False
        assert record["would_ask"]
    assert told("dtc", *BUS, *LONG)["bus"]["frames"] > 0
    assert car.heard == []
    assert told("did", "F190", *BUS, "-d", "dct")["would_ask"] == ["22 F1 90"]
    assert told("did", "F190", *BUS)["would_ask"] == ["22: F190"]
    shown = ended("dtc", *BUS).out
    assert "nothing was sent; with --active this would be asked:\n  19 02 AF: the codes\n" in shown


@contextmanager
def failing_car(channel: str) -> Iterator[tuple[Controller, tuple[str, ...]]]:
    """Return a controller of which two tests have failed, and the words that name its bus."""
    controller = parked_controller()
    for number in (SLIPS, SUMP):
        for _ in range(20):
            controller.report(number, Result.FAILED)
    with vehicle(channel, controller):
        yield controller, ("-i", "virtual", "-c", channel, *PATIENT)


def test_codes_are_cleared_one_by_one_and_all_together(monkeypatch: pytest.MonkeyPatch) -> None:
    with failing_car("clearing") as (controller, bus):
        would = told("dtc", "--clear", *bus)["would_ask"]
        assert would == ["19 02 AF: the codes", "14 FF FF FF: clear", "19 02 AF: what is left"]
        monkeypatch.setattr("workshop.tester.commands.is_confirmed", lambda question, _: "P0811" not in question)
        refused = told("dtc", "--clear", *bus, "--active")
        assert (refused["cleared"]["groups"], len(refused["codes"])) == ([], 2)
        monkeypatch.undo()  # nobody sits there: the command line has the word
        one = told("dtc", "--clear", "p0811", *bus, "--active")
        assert one["cleared"] == {
            "groups": ["081107"], "before": ["081107", "02184B"], "gone": ["081107"], "left": ["02184B"],
        }  # fmt: skip
        assert controller.state.memory.records[SLIPS].status == CLEARED
        shown = ended("dtc", "--clear", "all", "--session", "03", *bus, "--active").out
        assert shown.startswith("cleared FFFFFF: P0218 Transmission Fluid Over Temperature Condition (")
        assert shown.endswith("what is left:\nno trouble codes\n")
        assert (controller.state.memory.records[SUMP].status, controller.state.session) == (CLEARED, 1)
        away = ended("dtc", "--clear", "P2787", *bus, "--active")
        away.assert_one_line(2, "P2787 is not among the trouble codes that the controller reports: none")
        unknown = ended("dtc", "--clear", "123456", *bus, "--active")
        unknown.assert_one_line(3, "refuses 14 12 34 56: request out of range (31)")


def test_codes_come_with_what_was_kept(car: Vehicle) -> None:
    record = told("dtc", *BUS, "--active")
    assert (record["controller"], record["description"]) == ("7E1 (answers 7E9)", "TCU")
    (code,) = record["codes"]
    assert (code["code"], code["text"], code["states"][0]) == ("P0811", "Excessive Clutch Slippage", "failed")
    first = code["snapshots"][0]
    assert first["data"]["fluid temperature"] == {"temperature [degC]": 80}
    assert first["data"]["clutch temperature"] == {"clutch 1 [degC]": None, "clutch 2 [degC]": None}
    assert (first["rest"], code["extended_data"][0]["data"]) == ("", {"occurrence counter": {"occurrences": 1}})
    shown = ended("dtc", *BUS, "--active").out
    assert "P0811  07    2" in shown
    assert "fluid temperature: 80 degC" in shown


def test_data_by_number_by_name_and_all(car: Vehicle) -> None:
    refused = ended("did", "F190", "fluid temperature", "0999", *BUS, "--active", "--json")
    assert refused.status == 3
    assert "error: 1 of 3 data were not told: 0999: request out of range (31)" in refused.err
    found = refused.records[0]["data"]
    assert [one["values"] for one in found] == [
        {"VIN": "WDCTEMUL3TED00047"}, {"temperature [degC]": 80}, None,
    ]  # fmt: skip
    assert found[2]["refusal_text"] == "request out of range (31)"
    everything = {one["number"]: one for one in told("did", *BUS, "--active")["data"]}
    assert everything["0105"]["values"]["speed [rpm]"] == pytest.approx(811.75)
    assert everything["F200"]["refusal"] == 0x31  # not in this session
    (in_session,) = told("did", "F200", *BUS, "--active", "--session", "03")["data"]
    assert in_session["values"]["current gear"] == 0
    assert told("did", "F186", *BUS, "--active")["data"][0]["values"] == {"session": 1}  # and it was left


def test_a_routine_is_started_and_asked(car: Vehicle) -> None:
    unlock = ("--unlock", f"1={MASK}")
    refused = ended("routine", "0305", "start", *BUS, "--active")
    refused.assert_one_line(3, "refuses 31 01 03 05: security access denied (33)")
    started = told("routine", "0305", "start", *BUS, "--active", *unlock)["routine"]
    assert (started["number"], started["bytes"]) == ("0305", "01")
    wrong = ended("routine", "0301", "start", "--options", "00 01", *BUS, "--active", *unlock)
    wrong.assert_one_line(3, "request out of range (31)")


def test_a_scan_finds_the_controller_and_nothing_else(car: Vehicle) -> None:
    car.heard.clear()
    record = told("scan", *BUS, "--active", "--first", "7DE", "--last", "7EB", *WAIT, *LONG)
    (found,) = record["controllers"]
    assert (found["request_id"], found["response_id"]) == ("7E1", "7E9")
    assert {one["number"]: one["there"] for one in found["services"]} == dict.fromkeys(("3E", "22", "19"), True)
    assert found["trouble_codes"] == 1
    assert {"F190", "F197", "F186"} <= {one["number"] for one in found["data"]}
    assert set(car.heard) == set(range(0x7DE, 0x7EC)) - {BUSY_ID, 0x7DF, 0x7E9}  # neither others' nor everybody's
    shown = ended("scan", *BUS, "--active", "--first", "7E0", "--last", "7E1", *WAIT).out
    assert shown.startswith("1 controller answers\n7E1 (answers 7E9), trouble codes: 1\n")
    assert "  F190  vehicle identification number" in shown


@contextmanager
def another_tester(channel: str, can_id: int) -> Iterator[None]:
    is_over = threading.Event()

    def ask() -> None:
        with can.Bus(channel, "virtual") as bus:
            while not is_over.wait(0.005):
                bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=b"\x02\x3e\x80"))

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


@pytest.mark.parametrize("can_id", [0x7E0, 0x7DF])
def test_where_another_tester_is_at_work_nothing_is_asked(car: Vehicle, can_id: int) -> None:
    with another_tester(CHANNEL, can_id):
        car.heard.clear()
        ended("dtc", *BUS, *LONG, "--active").assert_one_line(
            3, f"another tester is asking on this bus (requests on {can_id:X})"
        )
        assert set(car.heard) == {can_id}


def test_over_ip() -> None:
    with entity() as (controller, server):
        for _ in range(20):
            controller.report(SLIPS, Result.FAILED)
        place = ("--doip", f"127.0.0.1:{server.place.port}", "--ecu", "1011", *PATIENT)
        assert told("dtc", *place)["asked"] is False
        record = told("dtc", *place, "--active")
        assert record["controller"] == f"1011 at DoIP 127.0.0.1:{server.place.port}"
        assert [code["code"] for code in record["codes"]] == ["P0811"]
        (found,) = told("scan", *place, "--active")["controllers"]
        assert (found["request_id"], len(found["services"])) == (None, 3)
        away = ended("dtc", *place[:1], "127.0.0.1:1", "--ecu", "1011", "--active")
        away.assert_one_line(3, "1011 at DoIP 127.0.0.1:1: ")
