"""The estimate on board: a service beside the controller that starts, ends, dies; its findings as trouble codes."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from dbc.contract import load_contract
from diag_service.diagnosis.records import dump, shift_record
from diag_service.store import ResultStore, StoreReader
from ecu_emulator.answering.answering_tester import Answering
from ecu_emulator.answering.monitoring import Monitoring
from ecu_emulator.answering.on_board import (
    LONGEST_COMPLAINT,
    MOST_STARTS,
    NEW_FLUID_NOTE,
    NOTHING_LEARNED,
    Complaints,
    EstimateSource,
    FixedEstimate,
    OnBoardService,
    without_settings,
)
from ecu_emulator.diagnostics.clutches import OnBoardFriction
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.iso14229 import Status
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.live.live_drive import BusChoice
from ecu_emulator.scenario.scenario import FluidVerdict
from tests.support.builders import shift_result
from tests.support.histories import fill_store, history
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.uds.days import HOLDING, TripCar

FLUID = 0x089700
WORN = OnBoardFriction(fluid=FluidVerdict.CHANGE_FLUID, mu_c=0.118, std_mu_c=0.002, mu_s=0.125, std_mu_s=0.003)


def wait_for(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.002)


def service(script: str, *words: str) -> OnBoardService:
    """Return the supervision of a program that is no service."""
    return OnBoardService(words, None, program=(sys.executable, "-S", "-c", script), first_pause_s=0.001)


def test_lines_become_estimates_and_the_rest_is_passed_over() -> None:
    line = dump(shift_record(shift_result()))
    script = f"import sys, time; print('no JSON'); print('x' * 3_000_000); print({line!r}, flush=True); time.sleep(1e6)"
    with service(script) as on_board:
        wait_for(lambda: on_board.estimates)
        clutch = shift_result().verdict.clutch
        assert on_board.estimates[clutch].fluid is FluidVerdict.GOOD
        assert on_board.problem is None


def test_it_is_started_again_a_few_times_and_then_given_up() -> None:
    with service("import sys; sys.exit('no bus')") as on_board:
        wait_for(lambda: on_board.problem)
        assert on_board.start_count == MOST_STARTS
        assert on_board.problem == f"the service on board ended {MOST_STARTS} times in a row: no bus"
        assert on_board.estimates == {}


def test_complaints_without_end_take_no_room() -> None:
    chatter = "import sys\nfor _ in range(40): sys.stderr.write('x' * 65_535 + '\\n')\nsys.exit('no bus')"
    with service(chatter) as on_board:
        wait_for(lambda: on_board.problem)
        assert on_board.problem == f"the service on board ended {MOST_STARTS} times in a row: no bus"
        assert sum(path.stat().st_size for path in on_board._folder.iterdir()) == 0


def test_of_complaints_the_end_is_kept(tmp_path: Path) -> None:
    (tmp_path / "said").write_bytes(b"x" * 3 * LONGEST_COMPLAINT + "\nfür immer\n\n".encode())
    with (tmp_path / "said").open("rb") as said:
        complaints = Complaints(said)
        assert complaints.last_line(HANG_S) == "für immer"
        assert len(complaints._end) <= LONGEST_COMPLAINT


def test_a_service_that_does_not_heed_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ecu_emulator.answering.on_board.END_S", 0.3)
    script = "import signal, time; signal.signal(15, signal.SIG_IGN); print('up', flush=True); time.sleep(1e6)"
    with service(script) as on_board:
        wait_for(lambda: on_board._child)
        child = on_board._child
        assert child is not None
        wait_for(lambda: int(status_of(child.pid, "SigIgn"), 16) >> 14 & 1)
    assert child.poll() == -signal.SIGKILL


def status_of(pid: int, key: str) -> str:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return next(line.split()[1] for line in lines if line.startswith(f"{key}:"))


PARENT = """
import time
from ecu_emulator.answering.on_board import OnBoardService
with OnBoardService(["-i", "virtual", "-c", "x"], None) as on_board:
    while on_board._child is None:
        time.sleep(0.01)
    print(on_board._child.pid, flush=True)
    time.sleep(1e6)
"""


def is_gone(pid: int) -> bool:
    try:
        return status_of(pid, "State") == "Z"
    except OSError:
        return True


def test_it_dies_with_its_parent_however_that_dies() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        os.kill(parent.pid, signal.SIGKILL)
    wait_for(lambda: is_gone(pid))


def drive(memory: Path, source: EstimateSource) -> Status:
    """Let a controller have an estimate for one operation cycle; return the status of the code of the fluid."""
    heard: list[can.Message] = []

    class Bus:
        def send(self, message: can.Message) -> None:
            heard.append(message)

    with Answering(Bus(), table="", memory=memory, doip=None, is_fd=False, on_board=source) as answering:
        for message in load_contract().messages:
            data = bytes(message.length)
            answering.send(can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False))
        records = answering.controller.state.memory.records
        if source.estimates:
            wait_for(lambda: not answering.controller.state.memory.records[FLUID].status & Status.NOT_TESTED_THIS_CYCLE)
            friction = answering.controller.ask(bytes.fromhex("22 03 00")) or b""
            assert friction[3:5] == round(source.estimates[1].mu_c * 1e5).to_bytes(2, "big")
            records = answering.controller.state.memory.records
            snapshot = answering.controller.ask(bytes.fromhex("19 04 08 97 00 02")) or b""
            assert (friction[3:11] in snapshot) is bool(records[FLUID].status & Status.TEST_FAILED)
        return Status(records[FLUID].status)


def test_worn_fluid_is_pending_then_confirmed_and_heals(tmp_path: Path) -> None:
    memory = tmp_path / "tcu.json"
    assert not drive(memory, FixedEstimate(None)) & Status.PENDING
    first = drive(memory, FixedEstimate(WORN))
    assert first & Status.PENDING
    assert not first & Status.CONFIRMED
    assert drive(memory, FixedEstimate(WORN)) & Status.CONFIRMED
    healed = drive(memory, FixedEstimate(OnBoardFriction(fluid=FluidVerdict.GOOD, mu_c=0.14)))
    assert not healed & Status.TEST_FAILED
    assert healed & Status.CONFIRMED  # until it has aged out


SPEAKING = """
import os, runpy, sys, time
if sys.argv[1] == "fluid-changed":
    runpy.run_module("diag_service", run_name="__main__")
first, late, new, go = {lines!r}
print(first, flush=True)
while not os.path.exists(go):
    time.sleep(0.01)
print(late)
print(new, flush=True)
time.sleep(1e6)
"""


def test_new_fluid_is_noted_and_the_last_word_on_the_old_one_is_not_heard(tmp_path: Path) -> None:
    store, go = tmp_path / "store.sqlite", tmp_path / "go"
    fill_store(store, history(1))
    record = {**shift_record(shift_result()), "end_bus_ns": 1_000_000_000}
    new_ns = time.time_ns() + 10**15
    lines = (json.dumps(record), json.dumps(record), json.dumps({**record, "end_bus_ns": new_ns}), str(go))
    program = (sys.executable, "-c", SPEAKING.format(lines=lines))
    with OnBoardService([], store, program=program, first_pause_s=0.001) as on_board:
        wait_for(lambda: on_board.estimates)
        assert on_board.begin_anew()
        assert on_board.estimates == {}
        go.touch()
        wait_for(lambda: on_board.estimates)
        assert [estimate.end_ns for estimate in on_board.estimates.values()] == [new_ns]
    with StoreReader.open(store) as reader:
        (fill,) = reader.fills("car1")
    assert fill.note == NEW_FLUID_NOTE


def test_who_has_learned_nothing_has_nothing_to_forget(tmp_path: Path) -> None:
    ResultStore.open(tmp_path / "empty.sqlite").close()
    told = ended("fluid-changed", tmp_path / "empty.sqlite")
    assert NOTHING_LEARNED in told.err  # what the emulator knows it by
    assert service(f"import sys; sys.exit('store x {NOTHING_LEARNED}')").begin_anew()
    assert not service("import sys; sys.exit('no disk')").begin_anew()
    assert not OnBoardService([], None, program=("/nowhere/python",)).begin_anew()


def test_the_bus_is_named_to_the_service_as_it_was_to_the_emulator() -> None:
    choice = BusChoice(interface="socketcan", channel="can0", bitrate=500_000, is_fd=True)
    assert choice.words == ["-i", "socketcan", "-c", "can0", "-b", "500000", "--fd"]
    assert BusChoice(interface=None, channel=None, bitrate=None, is_fd=False).words == []
    assert without_settings({"CLUTCHDIAG_BROKER": "x", "CAN_CHANNEL": "y"}) == {"CAN_CHANNEL": "y"}


class Following(FixedEstimate):
    """An estimate that follows what is driven, and says what the test lets it."""

    is_live = True


def test_friction_that_was_known_is_known_after_a_restart(tmp_path: Path) -> None:
    def started(source: EstimateSource) -> tuple[str, int]:
        """Return what is told of the friction of clutch 1, and the status of the code of the fluid."""
        car = TripCar(memory=tmp_path / "tcu.json", on_board=source)
        with car.answering:
            car.say(HOLDING)
            if source.estimates:
                wait_for(lambda: car.answering.controller.state.estimates == source.estimates)
            return car.ask("22 03 00"), car.status("P0897")

    unknown = f"62 03 00 {'ff ' * 8}".strip()
    assert started(Following(None))[0] == unknown
    known = started(Following(WORN))[0]
    assert known.startswith("62 03 00 2e 18")
    again, status = started(Following(None))
    assert again == known
    assert status & Status.NOT_TESTED_THIS_CYCLE  # what was known before is no test of today
    assert started(FixedEstimate(None))[0] == unknown  # a car without an estimate has none
    half = OnBoardFriction(mu_c=0.125)  # some of it is not available
    assert started(Following(half))[0] == started(Following(None))[0]
    with MemoryFile(tmp_path / "tcu.json", shipped_table()) as store:
        controller = Controller(shipped_table(), values=dict, clock=lambda: 0.0, chance=bytes, store=store)
        Monitoring(controller).note_cleared()
    assert started(Following(None))[0] == unknown  # after a change of the fluid
