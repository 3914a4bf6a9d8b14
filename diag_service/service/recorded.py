"""Logs through the pipeline: the frames of one drive, as fast as they can be read."""

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from diag_service.delivery import Outbox
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.summary import FrameCounts, Summary
from diag_service.errors import StoppedError
from diag_service.service.drive import OpenLog, gaps_in, warn_of_damage, warn_of_idle
from diag_service.service.drive_frames import DriveFrames
from diag_service.service.session import Session
from diag_service.service.stages import Stages
from diag_service.service.stopping import Trigger
from diag_service.service.tasks import first_error
from diag_service.service.two_senders import SenderWatch

NS_PER_MS = 1_000_000
STOPPED_TEXT = "stopped early"
_LOG = logging.getLogger(__name__)


async def run_logs(logs: Sequence[OpenLog], session: Session, *, stop: Trigger, outbox: Outbox | None) -> Summary:
    """Diagnose the logs of a drive, as ``open_drive`` put them; return the numbers.

    ``stop`` ends the analysis between two shifts; the shift that was open is not reported, so that a later analysis
    of the same logs takes it up. What is said of a part of a drive has no verdict, and the broker hears no state.
    """
    loop = asyncio.get_running_loop()

    def tell_outbox() -> None:
        if outbox is not None:
            loop.call_soon_threadsafe(outbox.nudge)

    unpublished_count: int | None = None
    drive = DriveFrames(logs, session.stages.sources)
    try:
        async with asyncio.TaskGroup() as tasks:
            sender = None if outbox is None else tasks.create_task(outbox.run(), name="outbox")
            is_whole = await asyncio.to_thread(_analyse, drive, session, stop, tell_outbox)
            gaps = gaps_in(logs, was_stopped=not is_whole)
            if outbox is not None and sender is not None:
                if not gaps:
                    outbox.release_states()
                unpublished_count = await outbox.close(sender)
    except BaseExceptionGroup as group:
        raise first_error(group) from group
    contributions = drive.contributions(session.stages.named_channel, is_whole=is_whole)
    warn_of_damage(logs)
    warn_of_idle(contributions)
    warn_of_slow_messages(session.stages)
    frames = frame_counts(logs, session.stages, is_whole=is_whole)
    if (text := SenderWatch().look(frames)) is not None:
        _LOG.warning("%s", text)
    return session.finish(frames, unpublished_count, gaps, contributions)


def _analyse(drive: DriveFrames, session: Session, stop: Trigger, tell_outbox: Callable[[], None]) -> bool:
    """Process the shifts of a drive; return whether that was all of them."""
    try:
        for event in events(drive, session.stages, stop):
            session.process(event)
            tell_outbox()
    except StoppedError:
        return False
    return True


def events(drive: DriveFrames, stages: Stages, stop: Trigger) -> Iterator[Event]:
    """Yield the shifts of a drive.

    Raises
    ------
    StoppedError
        As soon as it is told to stop, if there is anything left to do.
    """
    for batch in drive:
        yield from _until(stop, stages.segment(batch))
        if stop.is_set:
            raise StoppedError(STOPPED_TEXT)
    yield from _until(stop, stages.flush())


def _until(stop: Trigger, found: Sequence[Event]) -> Iterator[Event]:
    for event in found:
        if stop.is_set:
            raise StoppedError(STOPPED_TEXT)
        yield event


def frame_counts(logs: Sequence[OpenLog], stages: Stages, *, is_whole: bool) -> FrameCounts:
    """Return what became of the frames; of an analysis that was stopped those read ahead do not count."""
    unreadable: Counter[str] = Counter()
    for log in logs:
        unreadable.update({reason.value: count for reason, count in log.reader.counts.rejected.items()})
    counts = stages.frame_counts()
    read = sum(log.reader.counts.frames for log in logs) if is_whole else counts.on_bus
    return replace(counts, on_bus=read, unreadable=dict(unreadable))


def warn_of_slow_messages(stages: Stages) -> None:
    """Warn of messages that come less often than the database says; they are held against their own cycle."""
    by_cycles: dict[tuple[int, int], list[str]] = {}
    for name, (own_ns, nominal_ns) in stages.slow_messages.items():
        by_cycles.setdefault((round(own_ns / NS_PER_MS), round(nominal_ns / NS_PER_MS)), []).append(name)
    for (own_ms, nominal_ms), names in sorted(by_cycles.items()):
        _LOG.warning("frames every %d ms instead of %d ms: %s", own_ms, nominal_ms, ", ".join(names))
