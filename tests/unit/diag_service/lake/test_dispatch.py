"""Logs are handed out a few at a time, and a process that dies is blamed on the log that was alone with it."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.errors import StoreError
from diag_service.lake.parts import DONE, FAILED, LogRow
from diag_service.lake.places import Held
from diag_service.lake.pools import Outcome
from diag_service.lake.run import MOST_DEATHS, MOST_REFUSALS, WAITING_PER_WORKER, Dispatch
from diag_service.lake.work import Job, LakeLog, row_of
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig

JOB = Job(
    config=DiagnosisConfig(vehicle="car", calibration=nominal_calibration()),
    lake="lake", settings="s", signals=None, signal_settings="", time_limit_s=60.0,
)  # fmt: skip


def log_of(name: str) -> LakeLog:
    return LakeLog(place="logs", held=Held(name=name, size_bytes=1, mark="m"), vehicle="car")


class ScriptedPool:
    """A pool in which the processes of some logs die with all beside them; others are refused or lost."""

    def __init__(self, *, deadly: set[str], refused: dict[str, int], lost: set[str]) -> None:
        self.width = 2
        self.most_running = 0
        self._deadly, self._refused, self._lost = deadly, refused, lost
        self._running: list[tuple[LakeLog, int]] = []

    def submit(self, log: LakeLog, attempts: int) -> None:
        self._running.append((log, attempts))
        self.most_running = max(self.most_running, len(self._running))

    def finished(self, timeout_s: float) -> Sequence[Outcome]:
        del timeout_s
        running, self._running = self._running, []
        if any(log.held.name in self._deadly for log, _ in running):
            return [Outcome(log=log, is_blamed=True) for log, _ in running]
        return [self._outcome(log, attempts) for log, attempts in running]

    def withdraw(self) -> Sequence[LakeLog]:
        running, self._running = self._running, []
        return [log for log, _ in running]

    def close(self) -> None:
        pass

    def _outcome(self, log: LakeLog, attempts: int) -> Outcome:
        name = log.held.name
        if self._refused.get(name, 0):
            self._refused[name] -= 1
            return Outcome(log=log, error=StoreError("no"))
        if name in self._lost:
            self._lost.discard(name)
            return Outcome(log=log)
        return Outcome(log=log, row=replace(row_of(JOB, log, attempts), outcome=DONE))


def rows_of(pool: ScriptedPool, names: Sequence[str], stop: Trigger | None = None) -> list[LogRow]:
    return list(Dispatch(JOB, pool, [log_of(name) for name in names], stop or Trigger()).rows())


def test_every_log_gives_one_row_and_only_the_deadly_one_is_blamed() -> None:
    names = [f"{number}" for number in range(12)]
    pool = ScriptedPool(deadly={"4"}, refused={"7": MOST_REFUSALS - 1}, lost={"9"})
    rows = rows_of(pool, names)
    assert sorted(row.source for row in rows) == sorted(f"logs/{name}" for name in names)
    failed = [row for row in rows if row.outcome == FAILED]
    assert [(row.source, row.parts) for row in failed] == [("logs/4", ())]
    assert "its process died" in failed[0].reason
    assert MOST_DEATHS <= failed[0].attempts <= MOST_DEATHS + 1
    assert pool.most_running == WAITING_PER_WORKER * pool.width


def test_a_store_that_goes_on_refusing_ends_the_run() -> None:
    with pytest.raises(StoreError):
        rows_of(ScriptedPool(deadly=set(), refused={"1": MOST_REFUSALS}, lost=set()), ["0", "1"])


def test_a_run_that_is_stopped_hands_out_no_more() -> None:
    stop = Trigger()
    stop.set()
    assert rows_of(ScriptedPool(deadly=set(), refused={}, lost=set()), ["0", "1"], stop) == []
