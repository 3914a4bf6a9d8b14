"""One drive of many, in a process of its own: a fresh state, no store, no broker; records go back."""

import logging
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from canlog.errors import SourceError
from clutch_results.records import ShiftResult, shift_record
from diag_service.batch.drives import Drive
from diag_service.batch.journal import Entry
from diag_service.batch.processes import follow_parent
from diag_service.console import collected_notices, set_up_notices
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.summary import summary_record, unjudged, with_revisions
from diag_service.errors import StoppedError
from diag_service.mapping.interpretation import Interpretation
from diag_service.service.recorded import RecordedRun, run_recorded
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig
from diag_service.settings.proposed import as_proposed

DRIVE_SCHEMA = "clutchdiag/drive/v1"


@dataclass(frozen=True)
class Analyst:
    """Analyses drives by one configuration; database and profile are read once."""

    config: DiagnosisConfig

    @cached_property
    def _meaning(self) -> Interpretation:
        return self.config.interpretation()

    def analyse(self, drive: Drive, stop: Trigger | None = None) -> Entry:
        """Return the account of a drive and its shifts; a log that cannot be read gives the reason instead.

        Whoever sets ``stop`` ends it early, and the account says so.
        """
        config = replace(self.config, vehicle=drive.vehicle or self.config.vehicle)
        reporter, stop = MemoryReporter(), stop or Trigger()
        try:
            with collected_notices() as notices:
                with suppress(StoppedError):  # the run ends at once, and its account says so
                    config = as_proposed(config, drive.paths, lambda: stop.is_set)
                meaning = self._meaning if config.profile is self.config.profile else config.interpretation()
                run = run_recorded(config, drive.paths, None, reporter, stop, meaning=meaning)
        except SourceError as exc:
            return failed_entry(drive, str(exc))
        return drive_entry(drive.key, drive.paths, run, reporter.results, notices)


def drive_entry(
    key: str, paths: Iterable[Path], run: RecordedRun, results: Iterable[ShiftResult], notices: Sequence[str]
) -> Entry:
    """Return what a drive said, as journals and files of results keep it."""
    account = {"stream": run.stream, "summary": summary_record(run.summary), "notices": list(notices)}
    judged = (unjudged(one, run.summary.gaps) for one in results)  # the last one is taken for the drive's
    return Entry(key=key, drive={**_account(paths), **account}, shifts=tuple(map(shift_record, with_revisions(judged))))


def failed_entry(drive: Drive, error: str) -> Entry:
    """Return the account of a drive that could not be analysed."""
    return Entry(key=drive.key, drive={**_account(drive.paths), "error": error}, shifts=())


def _account(paths: Iterable[Path]) -> dict[str, object]:
    """Return the record of a drive of which nothing is known yet."""
    names = [str(path) for path in paths]
    return {"schema": DRIVE_SCHEMA, "paths": names, "stream": None, "error": None, "summary": None, "notices": []}


_ANALYSTS: list[Analyst] = []  # of this process: one, made when it starts


def start_worker(config: DiagnosisConfig, is_shown: bool) -> None:  # noqa: FBT001 - a pool hands arguments over by place
    """Prepare a process for drives of one configuration."""
    leave_to_parent(is_shown)
    _ANALYSTS.append(Analyst(config))


def leave_to_parent(is_shown: bool) -> None:  # noqa: FBT001 - likewise
    """Prepare a process: it leaves Ctrl-C to its parent and does not outlive it; says what it warns of."""
    follow_parent()
    if is_shown:
        set_up_notices(0)
    logging.getLogger("diag_service").setLevel(logging.WARNING)  # what is only notable the parent has said


def analyse_drive(drive: Drive) -> Entry:
    return _ANALYSTS[0].analyse(drive)
