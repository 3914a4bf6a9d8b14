"""A live bus through the pipeline: read, diagnosed, stored and published at the same time."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from contextlib import suppress

from canlog.errors import NOTICE, BusEndedError, SourceError
from canlog.live import BusSilence, LinkBreak, LiveSource, ReadSchedule
from clutchdiag_io.program import legible
from diag_service.delivery import Outbox
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.frame_counts import FrameCounts, frames_line
from diag_service.diagnosis.summary import Summary, shifts_line
from diag_service.errors import StoreError
from diag_service.service.application import first_error
from diag_service.service.session import SenderWatch, Session
from diag_service.service.snapshot import frame_counts
from diag_service.stopping import Trigger

COUNTS_PERIOD_S = 60.0
SHOW_PERIOD_S = 0.5
SENDERS_PERIOD_S = 2.0
RETRY_PERIOD_S = 5.0  # how often a full disk is asked for room
_LOG = logging.getLogger(__name__)


async def run_live(
    source: LiveSource,
    session: Session,
    *,
    stop: Trigger,
    counts_wanted: Trigger,
    outbox: Outbox | None,
    duration_s: float | None,
    show: Callable[[], None] = lambda: None,  # every ``SHOW_PERIOD_S``, and once more when all has ended
    schedule: ReadSchedule | None = None,  # learns what is waited for: the source need not hurry before
    end_asking: Callable[[], Awaitable[None]] | None = None,  # before the source closes: what is sent is heard
) -> Summary:
    """Diagnose a live bus until ``stop``, ``duration_s`` or its failure; return the numbers.

    The bus is read while a worker thread estimates; what it cannot keep up with is counted by the source. A shift that
    is open when the bus goes away or falls silent is reported as interrupted, one that had ended as it is. If the bus
    does not come back, all that was found is stored and told before its SourceError is raised; if a result cannot be
    stored, StoreError is raised.
    """

    def counts() -> FrameCounts:
        return frame_counts(source, session.stages)

    session.stages.judge_liveness(lambda text: _LOG.warning("%s", legible(text)))
    work, senders = _Work(session, outbox), SenderWatch()
    beside = {
        "closer": close_in_time(source, stop, duration_s, end_asking),
        "counts": _log_counts(session, counts, counts_wanted),
        "onlookers": _repeat(SHOW_PERIOD_S, show),
        "two senders": _repeat(SENDERS_PERIOD_S, lambda: senders.warn(counts())),
        "full disk": work.retry(),
    }
    try:
        failure, unpublished_count = await work.run(source, schedule or ReadSchedule(), beside)
    except BaseExceptionGroup as group:
        raise first_error(group) from group
    finally:
        await source.aclose()
    show()
    summary = session.finish(counts(), unpublished_count)
    if failure is not None:
        raise failure
    return summary


class _Work:
    """Reads a bus and has its shifts diagnosed, by one thread at a time while the event loop goes on."""

    def __init__(self, session: Session, outbox: Outbox | None) -> None:
        self._session = session
        self._outbox = outbox
        self._turn = asyncio.Lock()

    async def run(
        self, source: LiveSource, schedule: ReadSchedule, beside: Mapping[str, Coroutine[None, None, None]]
    ) -> tuple[SourceError | None, int | None]:
        """Read a bus to its end while other tasks run; return what ended it, and how many results are not sent."""
        failure: SourceError | None = None
        unpublished_count: int | None = None
        async with asyncio.TaskGroup() as tasks:
            sender = None if self._outbox is None else tasks.create_task(_keep_sending(self._outbox), name="outbox")
            helpers = [tasks.create_task(task, name=name) for name, task in beside.items()]
            try:
                await self._read(source, schedule)
            except BusEndedError as exc:
                _LOG.log(NOTICE, "%s", exc)
            except SourceError as exc:
                failure = exc
            await self._process(self._session.stages.flush())
            async with self._turn:  # a thread that stores would outlive its task
                for helper in helpers:
                    helper.cancel()
            if self._outbox is not None and sender is not None:
                unpublished_count = await self._outbox.close(sender)
        return failure, unpublished_count

    async def retry(self) -> None:
        """Try again and again to store what a full disk did not take; the next shift may be hours away."""
        while True:
            await asyncio.sleep(RETRY_PERIOD_S)
            async with self._turn:
                is_stored = await asyncio.to_thread(self._session.retry)
            if is_stored and self._outbox is not None:
                self._outbox.wake()

    async def _read(self, source: LiveSource, schedule: ReadSchedule) -> None:
        stages = self._session.stages
        async for part in source:
            events = stages.flush() if isinstance(part, LinkBreak | BusSilence) else stages.segment(part)
            schedule.wait_for(is_expecting=stages.is_expecting, due_ns=stages.due_ns)
            await self._process(events)

    async def _process(self, events: Sequence[Event]) -> None:
        for event in events:
            async with self._turn:
                await asyncio.to_thread(self._session.process, event)
            if self._outbox is not None:
                self._outbox.wake()


async def _keep_sending(outbox: Outbox) -> None:
    """Run the outbox to its end, again after each error but one of the store."""
    while True:
        try:
            return await outbox.run()
        except StoreError:
            raise
        except Exception as exc:  # noqa: BLE001 - whatever goes wrong there, the bus is diagnosed
            _LOG.error("sending results failed: %s; they are in the store, trying again", " ".join(str(exc).split()))
        await asyncio.sleep(outbox.limits.restart_pause_s)


async def close_in_time(
    source: LiveSource, stop: Trigger, duration_s: float | None, end_asking: Callable[[], Awaitable[None]] | None = None
) -> None:
    """Close the source at ``stop`` or after ``duration_s``; its iteration ends with what was received until then."""
    try:
        async with asyncio.timeout(duration_s):
            await _next(stop)
    except TimeoutError:
        _LOG.info("stopping after %g s", duration_s)
    if end_asking is not None:
        await end_asking()
    await source.aclose()


async def _log_counts(session: Session, frame_counts: Callable[[], FrameCounts], wanted: Trigger) -> None:
    """Log the counts at each SIGUSR1, and every ``COUNTS_PERIOD_S`` at level INFO."""
    while True:
        level = NOTICE
        try:
            async with asyncio.timeout(COUNTS_PERIOD_S):
                await _next(wanted)
        except TimeoutError:
            level = logging.INFO
        wanted.is_set = False
        frames = frame_counts()
        _LOG.log(level, "%s; %s", frames_line(frames), shifts_line(session.summary(frames, None)))


async def _repeat(period_s: float, action: Callable[[], None]) -> None:
    while True:
        action()
        await asyncio.sleep(period_s)


async def _next(trigger: Trigger) -> None:
    """Return when the trigger is set; any thread or signal handler may set it."""
    loop = asyncio.get_running_loop()
    is_set = asyncio.Event()

    def wake() -> None:
        with suppress(RuntimeError):  # whoever sets it may be too late: the loop has ended
            loop.call_soon_threadsafe(is_set.set)

    trigger.subscribe(wake)
    try:
        await is_set.wait()
    finally:
        trigger.unsubscribe(wake)
