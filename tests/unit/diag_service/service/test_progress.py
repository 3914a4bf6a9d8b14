"""A stage that hangs is seen, whatever the loop does meanwhile."""

import threading

import pytest

from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.records import ShiftResult
from diag_service.service.session import Progress, Stage
from diag_service.store import ResultStore, VehicleState
from tests.support.patience import HANG_S
from tests.unit.diag_service.service.test_live import gear_frames, session_for

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
    assert session.progress.stuck is None
    store.close()
