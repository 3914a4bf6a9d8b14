"""The live runner with a source in memory: order, failure, stop, and numbers that add up."""

import asyncio
import logging
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace

import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.live import BusSilence, LinkBreak, SourceCounts
from clutch_model.calibration import nominal_calibration
from clutch_results.records import Reason, ShiftResult
from dbc.contract import load_contract
from diag_service.delivery import MemoryReporter, Outbox, Reporter
from diag_service.errors import StoreError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import PROFILE_PATH, load_profile
from diag_service.service.live import run_live
from diag_service.service.session import Session, resume, versions_for
from diag_service.service.stages import Belief
from diag_service.settings.config import DiagnosisConfig
from diag_service.stopping import Trigger
from diag_service.store import ResultStore, VehicleState
from ecu_emulator.bus.frames import FrameEncoder
from ecu_emulator.sensing import Readings
from tests.support.memory_link import MemoryLink
from tests.support.patience import HANG_S

CALIBRATION = nominal_calibration()
VERSIONS = versions_for(CALIBRATION)
NOW = "2026-01-01T00:00:00.000000Z"
NS_PER_S = 1_000_000_000


class ListSource:
    """A bus whose batches are known before; it ends with an error, or stays silent until it is closed."""

    def __init__(self, batches: list[FrameBatch], failure: SourceError | None = None) -> None:
        self._batches = batches
        self._failure = failure
        self._closed = asyncio.Event()
        self.description = "list"
        received = sum(len(batch) for batch in batches)
        self.counts = SourceCounts(received=received + 5, kernel_dropped=7, queue_dropped=3, unsupported=2)

    async def __aiter__(self) -> AsyncIterator[FrameBatch]:
        for batch in self._batches:
            yield batch
        if self._failure is not None:
            raise self._failure
        await self._closed.wait()

    async def aclose(self) -> None:
        self._closed.set()


def gear_frames(shift_count: int) -> FrameBatch:
    """Return TCU_Shift frames alone: shifts up and down between first and second gear, the last one not finished."""
    t_s = np.arange(0.0, 4.0 * shift_count, 0.01)
    number, phase_s = np.divmod(t_s, 4.0)
    before, after = 1.0 + number % 2, 2.0 - number % 2
    readings = Readings(
        message="TCU_Shift",
        t_s=t_s,
        values={
            "current_gear": np.where((phase_s >= 3.0) & (number < shift_count - 1), after, before),
            "target_gear": np.where(phase_s >= 2.0, after, before),
            "preselected_gear": after,
            "shift_phase": np.zeros_like(t_s),
        },
    )
    frames = FrameEncoder(load_contract()).encode(readings)
    t_ns = np.rint(frames.t_s * NS_PER_S).astype(np.int64)
    return FrameBatch(t_ns=t_ns, can_id=frames.can_id, length=frames.length, data=frames.data)


def cut(batch: FrameBatch, size: int) -> list[FrameBatch]:
    return [batch[slice(first, first + size)] for first in range(0, len(batch), size)]


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory(keeps_state=True)) as store:
        yield store


def session_for(store: ResultStore, reporter: Reporter) -> Session:
    decoder = Decoder(load_contract(), load_profile(PROFILE_PATH))
    config = DiagnosisConfig(vehicle="car1", calibration=CALIBRATION)
    return Session(config, decoder, store, None, reporter, utc_now=lambda: NOW)


async def run(
    source: ListSource, session: Session, *, stop: Trigger | None = None, outbox: Outbox | None = None
) -> None:
    async with asyncio.timeout(HANG_S):
        await run_live(
            source,
            session,
            stop=stop or Trigger(),
            counts_wanted=Trigger(),
            outbox=outbox,
            duration_s=None if stop else 0.3,
        )


async def test_shifts_are_stored_and_told_in_order_and_frames_add_up(store: ResultStore) -> None:
    reporter = MemoryReporter()
    frames = gear_frames(4)
    await run(ListSource(cut(frames, 37)), session_for(store, reporter))
    assert list(store.results("car1")) == reporter.results
    assert [result.seq for result in reporter.results] == [1, 2, 3, 4]
    assert {(result.produced_at, result.stream) for result in reporter.results} == {(NOW, store.stream)}
    assert reporter.results[-1].estimate.reasons == (Reason.INTERRUPTED,)
    (summary,) = reporter.summaries
    assert summary.frames.is_balanced
    assert (summary.frames.on_bus, summary.frames.decoded) == (len(frames) + 12, len(frames))
    assert summary.shifts.by_status == {"valid": 0, "rejected": 4, "unobserved": 0}


async def test_a_failing_bus_is_told_after_all_it_gave(store: ResultStore) -> None:
    reporter = MemoryReporter()
    source = ListSource(cut(gear_frames(2), 100), SourceError("the bus went down"))
    with pytest.raises(SourceError, match="went down"):
        await run(source, session_for(store, reporter), stop=Trigger())
    assert [result.seq for result in reporter.results] == [1, 2]
    assert len(reporter.summaries) == 1


async def test_a_store_that_fails_ends_the_run_before_anything_is_told(
    store: ResultStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(result: ShiftResult, state: VehicleState) -> bool:
        raise StoreError("the disk is full")

    monkeypatch.setattr(store, "add", full)
    reporter = MemoryReporter()
    with pytest.raises(StoreError, match="full"):
        await run(ListSource(cut(gear_frames(2), 100)), session_for(store, reporter), stop=Trigger())
    assert reporter.results == []


async def test_a_link_hears_every_result_before_the_end(store: ResultStore) -> None:
    link = MemoryLink()

    @asynccontextmanager
    async def connect() -> AsyncIterator[MemoryLink]:
        yield link

    reporter = MemoryReporter()
    outbox = Outbox(store, "car1", connect, "memory")
    await run(ListSource(cut(gear_frames(5), 50)), session_for(store, reporter), outbox=outbox)
    assert sorted(link.results, key=lambda result: result.seq) == reporter.results  # the newest may go first
    assert reporter.summaries[0].unpublished_count == 0


def test_the_running_state_survives_a_restart(store: ResultStore) -> None:
    first = session_for(store, MemoryReporter())
    for event in first.stages.segment(gear_frames(3)):
        first.process(event)
    state = store.state("car1")
    assert state is not None
    assert resume(store, "car1", VERSIONS, CALIBRATION).to_json() == (state.filter_state, state.condition)


def test_a_state_of_other_versions_is_not_used(store: ResultStore, caplog: pytest.LogCaptureFixture) -> None:
    session = session_for(store, MemoryReporter())
    for event in session.stages.segment(gear_frames(3)):
        session.process(event)
    for other in (replace(VERSIONS, algorithm="older"), replace(VERSIONS, calibration="older")):
        caplog.clear()
        assert resume(store, "car1", other, CALIBRATION).to_json() == Belief.fresh(CALIBRATION).to_json()
        assert [record.levelno for record in caplog.records] == [logging.WARNING]
        assert "results stay" in caplog.text
    assert len(list(store.results("car1"))) == 2


class BreakingSource(ListSource):
    """A bus that is away for a moment after each batch."""

    async def __aiter__(self) -> AsyncIterator[FrameBatch | LinkBreak]:  # type: ignore[override]
        async for batch in super().__aiter__():
            yield batch
            yield LinkBreak(problem="away")


class SilentSource(ListSource):
    """A bus that falls silent once it has said everything, and stays open."""

    async def __aiter__(self) -> AsyncIterator[FrameBatch | BusSilence]:  # type: ignore[override]
        for batch in self._batches:
            yield batch
        yield BusSilence()
        await self._closed.wait()


@pytest.mark.parametrize(("end_s", "is_interrupted"), [(3.06, False), (2.5, True)])
async def test_silence_ends_the_stretch_and_what_had_ended_is_whole(
    store: ResultStore, end_s: float, *, is_interrupted: bool
) -> None:
    reporter, stop = MemoryReporter(), Trigger()
    source = SilentSource([gear_frames(2)[: round(end_s / 0.01)]])
    running = asyncio.create_task(run(source, session_for(store, reporter), stop=stop))
    async with asyncio.timeout(HANG_S):
        while not reporter.results:  # noqa: ASYNC110 - a reporter has nothing to wait for
            await asyncio.sleep(0.01)
    assert not running.done()
    stop.set()
    await running
    (result,) = reporter.results
    assert (result.estimate.from_gear, result.estimate.to_gear) == (1, 2)
    assert (Reason.INTERRUPTED in result.estimate.reasons) == is_interrupted


async def test_a_bus_that_was_away_interrupts_the_open_shift_and_nothing_else(store: ResultStore) -> None:
    reporter = MemoryReporter()
    frames = gear_frames(3)
    middle = round(2.5 / 0.01)  # a break of ten milliseconds, inside the first shift
    source = BreakingSource([frames[: middle + 1], frames[middle + 1 :]])
    await run(source, session_for(store, reporter))
    gears = [(one.estimate.from_gear, one.estimate.to_gear) for one in reporter.results]
    assert gears == [(1, 2), (1, 2), (2, 1), (1, 2)]  # the first in two halves: neither has both ends
    assert reporter.results[0].estimate.reasons == (Reason.INTERRUPTED,)
    assert reporter.results[2].estimate.reasons != (Reason.INTERRUPTED,)
    assert reporter.summaries[0].frames.decoded == len(frames)
