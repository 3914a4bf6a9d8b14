"""Folders of drives: what is not done yet is shared out among processes, journalled, and written as one table."""

import logging
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Unpack

from canlog.errors import NOTICE, SourceError
from canlog.files import is_there
from clutch_model.calibration import Calibration
from clutch_results.records import shift_from
from diag_service.api.analysis import Analysis, ResultTable
from diag_service.api.choices import AnyPath, AnyPaths, LogMeaning, named, optional_path, path_list
from diag_service.batch.drives import DriveLogs, LeftOut, find_drives
from diag_service.batch.tables import Entry, Journal, check_output, columns, write_results
from diag_service.batch.worker import (
    DEADLY,
    analyse_drive,
    failed_entry,
    job_count,
    progress_bar,
    run_in_processes,
    settings_digest,
)
from diag_service.console import collected_notices
from diag_service.delivery import Acknowledge
from diag_service.errors import IncompleteError, StoppedError
from diag_service.settings.config import DiagnosisConfig
from diag_service.settings.options import AnalyzeOptions, check_replaceable, diagnosis_config
from diag_service.stopping import Controls, Trigger

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderAnalysis:
    """What the drives in some folders say, each judged for itself.

    Attributes
    ----------
    drives : tuple of Analysis
        Those that could be read, by their names.
    unread : Mapping of str to str
        Logs that look like logs and could not be read, each with the reason.
    left_out : Mapping of str to str
        Files that are no logs, each with the reason.
    notices : tuple of str
        What concerns the run; what concerns a drive is in its own ``notices``.
    """

    drives: tuple[Analysis, ...]
    unread: Mapping[str, str]
    left_out: Mapping[str, str]
    notices: tuple[str, ...] = ()

    @property
    def shifts(self) -> ResultTable:
        """A row for each shift of all drives; the table that ``analyze -o`` writes."""
        return ResultTable(columns(), [row for drive in self.drives for row in drive.shifts])

    def __repr__(self) -> str:
        shifts = sum(len(drive.results) for drive in self.drives)
        others = f"{len(self.unread)} not read, {len(self.left_out)} left out"
        return f"<diag_service.FolderAnalysis: {len(self.drives)} drives, {shifts} shifts, {others}>"


def analyze_folders(
    paths: AnyPaths,
    *,
    output: AnyPath | None = None,
    jobs: int | None = None,
    has_vehicles: bool = False,
    is_strict: bool = False,
    **meaning: Unpack[LogMeaning],
) -> FolderAnalysis:
    """Diagnose every log in some folders as a drive of its own, as ``diag-service analyze FOLDER...`` does.

    Processes are started for it: a script that calls it must guard its top level by ``if __name__ == "__main__":``.
    All results are held in memory.

    Parameters
    ----------
    paths
        Folders, with what is below them; single logs among them are one drive together.
    output
        A ``.jsonl``, ``.csv`` or ``.parquet`` file for the results; one that is there is replaced. With it a run
        that was ended half-way, killed even, is taken up where it ended.
    jobs
        Drives at a time; by default one per core.
    has_vehicles
        Whether the folders below those that are named are called after vehicles, whose logs they hold.
    vehicle, dbc, profile, calibration, is_strict, columns
        As of ``analyze``.

    Raises
    ------
    ConfigError, DefinitionError, CalibrationError
        If an argument cannot be used, or a folder holds no log.
    SourceError
        If none of the logs can be read.
    IncompleteError
        If ``is_strict`` and a log or a channel contributed nothing.
    StoreError
        If a file cannot be written.
    """
    left_out, entries, calibration = dict[str, str](), list[Entry](), None
    options = AnalyzeOptions(
        logs=path_list(paths), output=optional_path(output), force=True, jobs=jobs,
        vehicle_from="path" if has_vehicles else None, strict=is_strict, **named(meaning),
    )  # fmt: skip
    with collected_notices() as notices:
        for news in analyze_drives(options, Controls()):
            if isinstance(news, LeftOut):
                left_out[str(news.path)] = news.reason
            elif isinstance(news, FolderTotals):
                entries, calibration = list(news.entries), news.calibration
    failed = (dict[str, Any](entry.drive) for entry in entries if not entry.drive["summary"])
    unread = {";".join(drive["paths"]): str(drive["error"]) for drive in failed}
    return FolderAnalysis(
        drives=tuple(_analysis(entry, calibration) for entry in entries if entry.drive["summary"]),
        unread=unread,
        left_out=left_out,
        notices=tuple(notices),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderTotals:
    """What became of all drives that are done, those of earlier runs too, in the order in which they were found."""

    counts: Mapping[str, int]
    entries: Iterable[Entry]
    calibration: Calibration  # by which they were analysed


def _analysis(entry: Entry, calibration: Calibration | None) -> Analysis:
    record: Mapping[str, Any] = entry.drive
    return Analysis(
        paths=tuple(map(Path, record["paths"])),
        results=tuple(map(shift_from, entry.shifts)),
        summary=record["summary"],
        notices=tuple(record["notices"]),
        calibration=calibration,
    )


def analyze_drives(
    options: AnalyzeOptions, controls: Controls, *, is_shown: bool = False
) -> Generator[LeftOut | tuple[DriveLogs, Entry] | FolderTotals, None, None]:
    """Analyse every drive in some folders, each for itself.

    Yield the files that are no drives, then each drive that was not done before, as soon as it is done, then the
    totals. What workers warn of, and a bar of progress, go to standard error if ``is_shown``.

    With an output the run has a journal beside it, which survives a kill: started again, it goes on where it ended.
    An output that is there without its journal is another's, and stays unless ``force`` is set. With ``vehicle_from``
    the folders say which vehicle a log is of.

    Besides what reading and writing raise, there is StoppedError if it was stopped before every drive was done, and of
    a strict run, after all was written, IncompleteError if a log or a channel gave nothing.
    """
    jobs, output, config = job_count(options.jobs), options.output, diagnosis_config(options)
    if output is not None:
        check_output(output)  # now, not after hours
        check_replaceable(output, is_forced=options.force or is_there(_journal_of(output)))
    if config.broker is not None:
        _LOG.warning("results of folders are not published")
        config = replace(config, broker=None, acknowledge=Acknowledge.BROKER)
    settings = settings_digest(config)
    has_vehicles = options.vehicle_from is not None
    drives, left_out = find_drives(options.paths, has_vehicles=has_vehicles, columns=config.columns)
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
        yield from left_out
        for drive, entry in _analysed(config, to_do, jobs, controls.stop, is_shown=is_shown):
            journal.add(entry)
            yield drive, entry
        done = [drive for drive in drives if drive.key in journal.done]
        counts: Counter[str] = Counter()
        for drive in done:
            counts.update(_counts(journal.entry(drive.key)))
        entries = (journal.entry(drive.key) for drive in done)
        yield FolderTotals(counts=counts, entries=entries, calibration=config.calibration)
        _conclude(journal, drives, counts, output)
    if config.is_strict and (idle := counts["idle"]):
        raise IncompleteError(f"{idle} of {len(drives)} drives have a log or a channel that contributed nothing")


def _conclude(journal: Journal, drives: Sequence[DriveLogs], counts: Mapping[str, int], output: Path | None) -> None:
    """Write the output, or raise StoppedError that says how to go on; raise SourceError if no drive could be read."""
    if counts["drives"] < len(drives):
        hint = "; run the same command again to continue" if output is not None else ""
        raise StoppedError(f"stopped early: {counts['drives']} of {len(drives)} drives are done{hint}")
    if output is not None:
        write_results(output, (journal.entry(drive.key) for drive in drives))
    if counts["failed"] == len(drives):
        error = journal.entry(drives[0].key).drive["error"]
        raise SourceError(f"none of {len(drives)} drives could be read, the first: {error}")
    if output is not None:
        _LOG.log(NOTICE, "%d shifts of %d drives in %s", counts["shifts"], len(drives), output)


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
        results = run_in_processes(partial(analyse_drive, config), drives, jobs, stop, is_shown=is_shown)
        for done_count, (drive, future) in enumerate(results, 1):
            progress.update(task, advance=drive.size_bytes, done=done_count)
            try:
                yield drive, future.result()
            except BrokenProcessPool:
                yield drive, failed_entry(drive, DEADLY)


def _counts(entry: Entry) -> dict[str, int]:
    """Return what one drive adds to the totals; ``idle`` are drives with a log or a channel that gave nothing."""
    summary = entry.drive["summary"]
    counts = {"drives": 1, "shifts": len(entry.shifts), "failed": int(summary is None)}
    if isinstance(summary, dict):
        counts |= {"cut": int(not summary["complete"]), "idle": int(bool(summary["idle"]))}
    return counts
