"""A run over folders: what is not done yet is shared out among processes, journalled, and written as one table."""

import hashlib
import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TextIO

from canlog.errors import NOTICE, SourceError
from clutch_results.records import dump
from clutchdiag_io.program import legible, replacement_refusal
from diag_service.batch.drives import DriveLogs, LeftOut, find_drives, left_out_record
from diag_service.batch.tables import Entry, Journal, check_output, write_results
from diag_service.batch.worker import (
    DEADLY,
    analyse_drive,
    failed_entry,
    job_count,
    progress_bar,
    shared_out,
    start_worker,
)
from diag_service.delivery import Acknowledge
from diag_service.diagnosis.summary import GAP_TEXT, Gap
from diag_service.errors import ConfigError, IncompleteError, StoppedError
from diag_service.service.drive import stream_of
from diag_service.service.session import versions_for
from diag_service.service.stopping import Trigger
from diag_service.settings.config import PROPOSED, DiagnosisConfig

ACCOUNT_VERSION = "4"  # of what a journal keeps of a drive; entries of an older one are made anew
_LOG = logging.getLogger(__name__)


class FolderListener:
    """Who hears of a run over folders; what is not overridden is not listened to."""

    def leave_out(self, files: Sequence[LeftOut]) -> None:
        """Hear which files are no drives, before the first one is analysed."""

    def add(self, drive: DriveLogs, entry: Entry) -> None:
        """Hear what one drive said, as soon as it is done; those that were done before are not told again."""

    def end(self, totals: Mapping[str, int], entries: Iterable[Entry]) -> None:
        """Hear what became of all drives that are done, in the order in which they were found."""


def analyse_folders(
    config: DiagnosisConfig,
    paths: Sequence[Path],
    *,
    output: Path | None,
    jobs: int | None,
    listener: FolderListener,
    stop: Trigger,
    is_shown: bool = False,
    is_forced: bool = False,
    has_vehicles: bool = False,
) -> None:
    """Analyse every drive that the paths stand for.

    What workers warn of, and a bar of progress, go to standard error if ``is_shown``.

    With an output the run has a journal beside it, which survives a kill: started again, it goes on where it ended.
    An output that is there without its journal is another's, and stays unless ``is_forced``. With ``has_vehicles`` the
    folders say which vehicle a log is of.

    Besides what reading and writing raise, there is StoppedError if it was stopped before every drive was done, and of
    a strict run, after all was written, IncompleteError if a log or a channel gave nothing.
    """
    jobs = job_count(jobs)
    if output is not None:
        check_output(output)  # now, not after hours
        is_ours = is_forced or _journal_of(output).exists()
        if text := replacement_refusal(output, is_forced=is_ours):
            raise ConfigError(text)
    if config.broker is not None:
        _LOG.warning("results of folders are not published")
        config = replace(config, broker=None, acknowledge=Acknowledge.BROKER)
    settings = settings_digest(config)
    found = find_drives(paths, has_vehicles=has_vehicles, columns=config.columns)
    drives = found.drives
    for vehicle in {drive.vehicle for drive in drives if drive.vehicle is not None}:
        replace(config, vehicle=vehicle)  # complains of a calibration of another one
    with ExitStack() as stack:
        if output is None:
            path = Path(stack.enter_context(TemporaryDirectory(prefix="clutchdiag-"))) / "journal"
        else:
            path = _journal_of(output)
        journal = stack.enter_context(Journal(path, settings))
        to_do = [drive for drive in drives if drive.key not in journal.done]
        if len(to_do) < len(drives):
            _LOG.log(NOTICE, "%d of %d drives were done before", len(drives) - len(to_do), len(drives))
        listener.leave_out(found.left_out)
        for drive, entry in _analysed(config, to_do, jobs, stop, is_shown=is_shown):
            journal.add(entry)
            listener.add(drive, entry)
        totals = _conclude(journal, drives, output, listener)
    if config.is_strict and (idle := totals["idle"]):
        raise IncompleteError(f"{idle} of {len(drives)} drives have a log or a channel that contributed nothing")


def settings_digest(config: DiagnosisConfig) -> str:
    """Return a digest of all that decides about results besides the logs: their files and the versions."""
    versions = versions_for(config.calibration)
    files = stream_of(config.interpretation().files)
    parts = [config.vehicle, versions.algorithm, versions.calibration, files, str(config.is_strict), ACCOUNT_VERSION]
    parts += [config.columns] if config.columns else []
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _journal_of(output: Path) -> Path:
    return output.with_name(f"{output.name}.journal")


def _analysed(
    config: DiagnosisConfig, drives: Sequence[DriveLogs], jobs: int, stop: Trigger, *, is_shown: bool
) -> Iterator[tuple[DriveLogs, Entry]]:
    """Yield drives as they are done, in no order; when told to stop, those that were begun."""
    if not drives:
        return
    with progress_bar(is_shown=is_shown) as progress:
        task = progress.add_task("analysing", total=sum(drive.size_bytes for drive in drives), done=0, of=len(drives))
        found = shared_out(analyse_drive, drives, jobs, stop, start_worker, (config, is_shown))
        for done_count, (drive, future) in enumerate(found, 1):
            progress.update(task, advance=drive.size_bytes, done=done_count)
            try:
                yield drive, future.result()
            except BrokenProcessPool:
                yield drive, failed_entry(drive, DEADLY)


def _conclude(
    journal: Journal, drives: Sequence[DriveLogs], output: Path | None, listener: FolderListener
) -> Counter[str]:
    """Write the output, or say how to go on; return what became of the drives."""
    done = [drive for drive in drives if drive.key in journal.done]
    totals: Counter[str] = Counter()
    for drive in done:
        totals.update(_counts(journal.entry(drive.key)))
    listener.end(totals, (journal.entry(drive.key) for drive in done))
    if len(done) < len(drives):
        hint = "; run the same command again to continue" if output is not None else ""
        raise StoppedError(f"stopped early: {len(done)} of {len(drives)} drives are done{hint}")
    if output is not None:
        write_results(output, (journal.entry(drive.key) for drive in drives))
    if totals["failed"] == len(drives):
        error = journal.entry(drives[0].key).drive["error"]
        raise SourceError(f"none of {len(drives)} drives could be read, the first: {error}")
    if output is not None:
        _LOG.log(NOTICE, "%d shifts of %d drives in %s", totals["shifts"], len(drives), output)
    return totals


def _counts(entry: Entry) -> dict[str, int]:
    """Return what one drive adds to the totals; ``idle`` are drives with a log or a channel that gave nothing."""
    summary = entry.drive["summary"]
    counts = {"drives": 1, "shifts": len(entry.shifts), "failed": int(summary is None)}
    if isinstance(summary, dict):
        counts |= {"cut": int(not summary["complete"]), "idle": int(bool(summary["idle"]))}
    return counts


class FolderLines(FolderListener):
    """A line per drive on standard output: for people, or a JSON record per shift and drive."""

    def __init__(self, stream: TextIO, *, as_json: bool) -> None:
        self._stream = stream
        self._as_json = as_json
        self._left_out = 0

    def add(self, drive: DriveLogs, entry: Entry) -> None:
        if self._as_json:
            for record in (*entry.shifts, entry.drive):
                self._write(dump(record))
            return
        self._write(f"{legible(drive.name)}: {drive_line(entry)}")

    def leave_out(self, files: Sequence[LeftOut]) -> None:
        """Tell of files that are no drives: people on standard error, each with its reason."""
        self._left_out = len(files)
        for one in files:
            _LOG.log(NOTICE, "left out: %s: %s", one.path, one.reason)
            if self._as_json:
                self._write(dump(left_out_record(one)))

    def end(self, totals: Mapping[str, int], entries: Iterable[Entry]) -> None:  # noqa: ARG002 - all were told before
        if not self._as_json:
            left_out = f", {self._left_out} files left out" if self._left_out else ""
            cut = f", {totals['cut']} are cut off and have no verdict" if totals["cut"] else ""
            what = f"{totals['drives']} drives, {totals['shifts']} shifts, {totals['failed']} could not be read"
            self._write(f"{what}{cut}{left_out}")

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()


def drive_line(entry: Entry) -> str:
    summary = entry.drive["summary"]
    if not isinstance(summary, dict):
        return f"not read: {entry.drive['error']}"
    statuses = {name: count for name, count in summary["shifts"]["by_status"].items() if count}
    counts = f" ({', '.join(f'{count} {name}' for name, count in statuses.items())})" if statuses else ""
    clutches = [f"clutch {one['clutch']} {one['condition'].replace('_', ' ')}" for one in summary["clutches"]]
    tier = f"tier {summary['capability']['tier'] or 'none'}"
    if summary["capability"]["profile"] == PROPOSED:
        tier += ", columns read as proposed"
    frames = summary["frames"]
    parts = [
        f"{frames['on_bus']} frames",
        f"{sum(frames['rejected'].values())} rejected",
        tier,
        f"{len(entry.shifts)} shifts{counts}",
        *clutches,
        *(GAP_TEXT[Gap(gap)] for gap in summary["incomplete"]),
        *summary["idle"],
    ]
    return ", ".join(parts)
