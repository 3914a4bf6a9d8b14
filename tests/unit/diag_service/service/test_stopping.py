"""A service tells its life to its manager, is seen to hang, and stops when told."""

import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from clutch_results.records import ShiftResult
from diag_service.delivery import MemoryReporter
from diag_service.service.bus_run import notify
from diag_service.service.session import Progress, Stage
from diag_service.stopping import Trigger, patient_trigger
from diag_service.store import ResultStore, VehicleState
from tests.support.patience import HANG_S
from tests.unit.diag_service.service.test_live import gear_frames, session_for


def test_every_setting_is_told_until_the_listener_leaves() -> None:
    trigger, heard = Trigger(), list[str]()

    def listen() -> None:
        heard.append("now")

    trigger.subscribe(listen)
    assert not heard
    trigger.set()
    trigger.set()
    trigger.unsubscribe(listen)
    trigger.set()
    assert heard == ["now", "now"]


def test_a_signal_sets_the_trigger_instead_of_ending_the_process() -> None:
    before = signal.getsignal(signal.SIGUSR2)
    trigger = Trigger()
    try:
        trigger.listen_to(signal.SIGUSR2)
        signal.raise_signal(signal.SIGUSR2)
    finally:
        signal.signal(signal.SIGUSR2, before)
    assert trigger.is_set


def test_a_patient_trigger_waits_for_the_writer_of_a_pipe() -> None:
    first, is_over = Trigger(), threading.Event()
    patient = patient_trigger(first, patience_s=0.05)
    patient.subscribe(is_over.set)
    assert not is_over.is_set()
    first.set()
    first.set()  # the same Ctrl-C, from the terminal and from a wrapper
    assert is_over.wait(HANG_S)
    assert patient.is_set


@pytest.fixture(name="manager_socket")
def _manager_socket(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(tmp_path / "notify"))
        heard.settimeout(HANG_S)
        yield heard


def test_a_manager_is_told_the_life_of_the_service(manager_socket: socket.socket) -> None:
    notify(None, "READY=1")
    notify(manager_socket.getsockname(), "WATCHDOG=1\nSTATUS=bus up")
    notify(f"{manager_socket.getsockname()}-of-nobody", "READY=1")
    assert manager_socket.recv(200).decode() == "WATCHDOG=1\nSTATUS=bus up"


STUCK_AFTER_S = 30.0


class Clock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now_s = 1_000.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now_s


def test_a_store_that_hangs_is_seen_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, may_go_on, is_inside = Clock(), threading.Event(), threading.Event()
    store = ResultStore.in_memory()
    add = store.add

    def hang(result: ShiftResult, state: VehicleState) -> None:
        is_inside.set()
        may_go_on.wait(HANG_S)
        add(result, state)

    monkeypatch.setattr(store, "add", hang)
    session = session_for(store, MemoryReporter())
    session.progress = Progress(limit_s=STUCK_AFTER_S, now_s=clock)
    (event, *_) = session.stages.segment(gear_frames(3))
    worker = threading.Thread(target=session.process, args=(event,))
    worker.start()
    assert is_inside.wait(HANG_S)
    clock.now_s += STUCK_AFTER_S
    stuck = session.progress.stuck
    assert stuck is not None
    assert stuck.stage is Stage.STORE
    may_go_on.set()
    worker.join()
    store.close()
    assert session.progress.stuck is None
    store.close()


def test_a_trigger_that_ended_one_part_of_a_run_can_end_the_next_one_too() -> None:
    trigger, heard = Trigger(), list[str]()
    trigger.subscribe(lambda: heard.append("now"))
    trigger.set()
    trigger.rearm()
    was_set = trigger.is_set
    trigger.set()
    assert (was_set, trigger.is_set, heard) == (False, True, ["now", "now"])
