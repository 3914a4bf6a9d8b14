"""The workshop routine that a tester starts: the car performs it, and its tester hears when it is over."""

import time
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import can
import pytest

from ecu_emulator.bus.sender import to_messages
from ecu_emulator.drive.recording import SHORT_STRETCH_S, Drive
from ecu_emulator.scenario.scenario import Scenario, WorkshopRoutine
from ecu_emulator.truth import Happened, RevTruth, ShiftTruth
from tests.support.builders import drive_scenario
from tests.support.patience import HANG_S
from tests.support.traffic import START_NS
from workshop.controller.answers import Answering, Answers

MASK = bytes.fromhex("5aa5c33c")
TESTER = 7
SHIFTS = 10  # of a cycle


class Bus:
    def send(self, message: can.Message) -> None:
        """Take a frame."""


class Bench:
    """A car in a workshop, faster than a real one: its frames reach the controller as fast as they are made."""

    def __init__(self, scenario: Scenario, table: Path) -> None:
        self.drive = Drive(scenario)
        self.answering = Answering(Bus(), Answers(table=table), performer=self.drive)
        self.happened: list[Happened] = []
        self.t_s = 0.0
        self._stretches = self.drive.stretches(SHORT_STRETCH_S)

    def go_on(self) -> None:
        stretch = next(self._stretches)
        self.happened += stretch.truths
        self.t_s = stretch.end_s
        for message in to_messages(stretch.frames, START_NS * 1e-9):
            self.answering.send(message)

    def count(self, kind: type[Happened]) -> int:
        return sum(isinstance(one, kind) for one in self.happened)

    def ask(self, request: str) -> bytes:
        return self.answering.controller.ask(bytes.fromhex(request), client=TESTER) or b""

    def unlock(self) -> None:
        assert self.ask("10 03")[0] == 0x50
        seed = self.ask("27 01")[2:]
        key = bytes(one ^ other for one, other in zip(seed, MASK, strict=True))
        assert self.ask(f"27 02 {key.hex()}")[0] == 0x67

    def final(self) -> bytes:
        """Return the response that 78 has promised."""
        found = [b""]

        def has_come() -> bool:
            found[0] = self.answering.controller.tick(TESTER) or found[0]
            return found[0][:1] == b"\x71"

        wait_for(has_come)
        return found[0]


def wait_for(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def in_workshop(fluid: str = "case2") -> Scenario:
    return replace(drive_scenario("noise_only", fluid=fluid, seed=3), routine=WorkshopRoutine(on_request=True))


@pytest.fixture(name="table")
def _table(tmp_path: Path) -> Path:
    return hasty_table(tmp_path)


def hasty_table(folder: Path) -> Path:
    """Return the shipped table, without the seconds for which the engine must have run: of real time."""
    text = files("workshop.controller").joinpath("tcu.toml").read_text(encoding="utf-8")
    before, after = text.split("minimum = 5.0, nrc = 0x85", 1)
    path = folder / "table.toml"
    path.write_text(f"{before}minimum = 0.0, nrc = 0x85{after}", encoding="utf-8")
    return path


def test_the_car_performs_the_routine_and_its_tester_hears_when_it_is_over(table: Path) -> None:
    bench = Bench(in_workshop(), table)
    with bench.answering:
        while bench.t_s < 1.0:
            bench.go_on()
        bench.unlock()
        assert bench.ask("31 01 03 01 01 02") == b"\x7f\x31\x78"
        while bench.drive.is_waiting:
            bench.go_on()
            time.sleep(0.02)  # the controller looks after its routines ten times a second
        while bench.count(ShiftTruth) < SHIFTS:
            bench.go_on()
        end_s = bench.t_s + 1.0  # by then the bus says that the last gear is in
        while bench.t_s < end_s:
            bench.go_on()
        assert (bench.final(), bench.ask("31 03 03 01")) == (b"\x71\x01\x03\x01\x00", b"\x71\x03\x03\x01\x00")
    assert [one.are_clutches_closed for one in bench.happened if isinstance(one, RevTruth)] == [False, True, True]


def test_a_car_that_drives_does_not_take_up_the_routine(table: Path) -> None:
    bench = Bench(drive_scenario("noise_only"), table)
    with bench.answering:
        while bench.t_s < 1.0:
            bench.go_on()
        bench.unlock()
        assert bench.ask("31 01 03 01 01 02")[:2] == b"\x7f\x31"
        bench.drive.order(lambda plant: plant.begin_routine(1, 0))  # nor if somebody insists
        while not bench.count(ShiftTruth):
            bench.go_on()
    assert not bench.count(RevTruth)
