"""Logs through the pipeline into a store and to a broker: the frames of one drive, as fast as they can be read."""

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from canlog.errors import InputLeftError
from canlog.logs.reading import Watch
from clutchdiag_io.program import legible
from diag_service.delivery import Outbox, Reporter
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.diagnosis.summary import Contributions, Gap, Summary
from diag_service.errors import StoppedError
from diag_service.mapping.interpretation import Interpretation
from diag_service.service.application import first_error, opened_store, outbox_of, run_to_end
from diag_service.service.drive import (
    DriveFrames,
    OpenLog,
    check_complete,
    gaps_in,
    open_drive,
    stream_of_drive,
    warn_of_faults,
)
from diag_service.service.log_decision import decide_log
from diag_service.service.session import SenderWatch, Session
from diag_service.service.stages import Stages
from diag_service.settings.config import DiagnosisConfig
from diag_service.stopping import Trigger
from diag_service.store import KeptEvents

if TYPE_CHECKING:  # which knows what the core does without
    from diag_service.service.drive_survey import DriveSurvey

NS_PER_MS = 1_000_000
STOPPED_TEXT = "stopped early"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """What became of the frames of a drive."""

    frames: FrameCounts
    gaps: tuple[Gap, ...]  # why it is not the whole drive
    contributions: Contributions

    def check_complete(self, *, is_strict: bool) -> None:
        """Raise StoppedError or IncompleteError if it is a part, or if a log of a strict run gave nothing."""
        check_complete(self.gaps, self.contributions, is_strict=is_strict)


async def _replay_and_send(
    logs: Sequence[OpenLog], session: Session, stop: Trigger, process: Callable[[Event], None], outbox: Outbox
) -> tuple[Account, int]:
    """Replay a drive and send its results meanwhile; of a part of a drive the broker hears no state.

    Return what became of the frames, and how many results were not delivered.
    """
    loop = asyncio.get_running_loop()

    def process_and_send(event: Event) -> None:
        outbox.await_fleet()
        process(event)
        loop.call_soon_threadsafe(outbox.wake)

    try:
        async with asyncio.TaskGroup() as tasks:
            sender = tasks.create_task(outbox.run(), name="outbox")
            account = await asyncio.to_thread(replay, logs, session.stages, stop, process_and_send)
            await asyncio.to_thread(outbox.await_fleet)
            if not account.gaps:
                outbox.release_states()
            unpublished_count = await outbox.close(sender)
    except BaseExceptionGroup as group:
        raise first_error(group) from group
    return account, unpublished_count


def replay(logs: Sequence[OpenLog], stages: Stages, stop: Trigger, use: Callable[[Event], None]) -> Account:
    """Call ``use`` with each shift of a drive until ``stop`` is set; warn of what is wrong with its logs."""
    drive = DriveFrames(logs, stages.decoder.sources)
    is_whole = True
    try:
        for event in events(drive, stages, stop):
            use(event)
    except (StoppedError, InputLeftError):
        is_whole = False
    contributions = drive.contributions(stages.decoder.named_channel, is_whole=is_whole)
    warn_of_faults(logs, contributions)
    return Account(
        frames=frame_counts(logs, stages, is_whole=is_whole),
        gaps=gaps_in(logs, was_stopped=not is_whole),
        contributions=contributions,
    )


def events(drive: DriveFrames, stages: Stages, stop: Trigger) -> Iterator[Event]:
    """Yield the shifts of a drive.

    Raises StoppedError as soon as ``stop`` is set, if there is anything left to do.
    """
    for batch in drive:
        yield from _until(stop, stages.segment(batch))
        if stop.is_set:
            raise StoppedError(STOPPED_TEXT)
    yield from _until(stop, stages.flush())


def _until(stop: Trigger, events: Sequence[Event]) -> Iterator[Event]:
    for event in events:
        if stop.is_set:
            raise StoppedError(STOPPED_TEXT)
        yield event


def frame_counts(logs: Sequence[OpenLog], stages: Stages, *, is_whole: bool) -> FrameCounts:
    """Return what became of the frames; of an analysis that was stopped those read ahead do not count."""
    unreadable: Counter[str] = Counter()
    for log in logs:
        unreadable.update({reason.value: count for reason, count in log.reader.counts.rejected.items()})
    counts = stages.decoder.counts
    read = sum(log.reader.counts.frames for log in logs) if is_whole else counts.on_bus
    return replace(counts, on_bus=read, unreadable=dict(unreadable))


def warn(text: str) -> None:
    """Warn of what is taken as absent, or of the profile that fits better."""
    _LOG.warning("%s", legible(text))


def warn_of_slow_messages(stages: Stages) -> None:
    """Warn of messages that come less often than the database says; they are held against their own cycle."""
    by_cycles: dict[tuple[int, int], list[str]] = {}
    for name, (own_ns, nominal_ns) in stages.decoder.slow_messages.items():
        by_cycles.setdefault((round(own_ns / NS_PER_MS), round(nominal_ns / NS_PER_MS)), []).append(name)
    for (own_ms, nominal_ms), names in sorted(by_cycles.items()):
        _LOG.warning("frames every %d ms instead of %d ms: %s", own_ms, nominal_ms, ", ".join(names))


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedRun:
    """A drive that was diagnosed; the summary says whether it was all of it."""

    stream: str  # by which its results are known
    summary: Summary


def run_recorded(
    config: DiagnosisConfig,
    paths: Sequence[Path],
    store_path: Path | None,
    reporter: Reporter,
    stop: Trigger,
    *,
    watch: Watch | None = None,  # of how far the reading is
    survey: "type[DriveSurvey] | None" = None,
    meaning: Interpretation | None = None,  # of the frames, where it is at hand: that of the configuration
    look: Callable[[Event], None] = lambda _event: None,  # called with each event after its result was reported
) -> RecordedRun:
    """Diagnose the logs of a drive; what is said of a part of a drive has no verdict.

    ``stop`` ends the analysis between two shifts; the shift that was open is not reported, so that a later analysis
    of the same logs takes it up. Raises what ``open_drive`` and ``opened_store`` raise, ConfigError for frames that
    cannot be interpreted.
    """
    decision = decide_log(
        meaning or config.interpretation(),
        config.calibration,
        paths,
        lambda: stop.is_set,
        columns=config.columns,
    )
    for note in decision.notes:
        warn(note)
    meaning = decision.meaning
    decoder = meaning.decoder()
    with open_drive(
        paths, is_strict=config.is_strict, is_stopped=lambda: stop.is_set, watch=watch, columns=config.columns
    ) as logs:
        stream = stream_of_drive((log.path for log in logs), meaning.files)
        with opened_store(config, store_path, keeps_results=False) as store:
            kept_events = KeptEvents.beside(store_path)
            session = Session(config, decoder, store, stream, reporter, survey=survey, kept_events=kept_events)
            session.stages.absences = decision.absences
            if not decision.is_of_whole:  # what comes through a pipe cannot be looked at before
                session.stages.judge_liveness(warn)

            def process(event: Event) -> None:
                session.process(event)
                look(event)

            unpublished_count: int | None = None
            if (outbox := outbox_of(config, store, session, is_live=False)) is None:
                account = replay(logs, session.stages, stop, process)
            else:
                work = _replay_and_send(logs, session, stop, process, outbox)
                account, unpublished_count = run_to_end(work)
            warn_of_slow_messages(session.stages)
            SenderWatch().warn(account.frames)
            summary = session.finish(account.frames, unpublished_count, account.gaps, account.contributions)
    if unpublished_count and store_path is None:
        _LOG.warning("%d results were not delivered and are not kept; --store would keep them", unpublished_count)
    return RecordedRun(stream=stream, summary=summary)
