"""One drive of many, in a process of its own: a fresh state, no store, no broker; records go back."""

import logging
import os
import signal
import threading
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import parent_process

from canlog.errors import SourceError
from diag_service.batch.drives import Drive
from diag_service.batch.journal import Entry
from diag_service.console.collecting import collected_notices
from diag_service.console.notices import set_up_notices
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.results import shift_record
from diag_service.diagnosis.summary import summary_record, unjudged
from diag_service.mapping.interpretation import Interpretation
from diag_service.service.drive import open_drive, stream_of
from diag_service.service.recorded import run_logs
from diag_service.service.session import Session
from diag_service.service.stopping import Trigger, ignore
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import ResultStore

DRIVE_SCHEMA = "clutchdiag/drive/v1"


@dataclass(frozen=True)
class Analyst:
    """Analyses drives by one configuration; database and profile are read once."""

    config: DiagnosisConfig

    @cached_property
    def _meaning(self) -> Interpretation:
        return self.config.interpretation()

    def analyse(self, drive: Drive) -> Entry:
        """Return the account of a drive and its shifts; a log that cannot be read gives the reason instead."""
        head: dict[str, object] = {"schema": DRIVE_SCHEMA, "paths": [str(path) for path in drive.paths]}
        try:
            with collected_notices() as notices:
                stream, reporter = self._run(drive)
        except SourceError as exc:
            return Entry(
                key=drive.key,
                drive={**head, "stream": None, "error": str(exc), "summary": None, "notices": []},
                shifts=(),
            )
        (summary,) = reporter.summaries
        account: dict[str, object] = {
            **head,
            "stream": stream,
            "error": None,
            "summary": summary_record(summary),
            "notices": notices,
        }
        results = (unjudged(one, summary.gaps) for one in reporter.results)  # the last one is taken for the drive's
        return Entry(key=drive.key, drive=account, shifts=tuple(map(shift_record, results)))

    def _run(self, drive: Drive) -> tuple[str, MemoryReporter]:
        config = replace(self.config, vehicle=drive.vehicle or self.config.vehicle)
        logs = open_drive(drive.paths, is_strict=self.config.is_strict)
        stream = stream_of([*(log.path for log in logs), *self._meaning.files])
        reporter = MemoryReporter()
        with closing(ResultStore.in_memory()) as store:
            session = Session(config, self._meaning.decoder(), store, stream, reporter)
            run_logs(logs, session, stop=Trigger())
        return stream, reporter


_ANALYSTS: list[Analyst] = []  # of this process: one, made when it starts


def start_worker(config: DiagnosisConfig, is_shown: bool) -> None:  # noqa: FBT001 - a pool hands arguments over by place
    """Prepare a process for drives: it leaves Ctrl-C to its parent and does not outlive it; says what it warns of."""
    ignore(signal.SIGINT)
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    if is_shown:
        set_up_notices(0)
    logging.getLogger("diag_service").setLevel(logging.WARNING)  # what is only notable the parent has said
    _ANALYSTS.append(Analyst(config))


def analyse_drive(drive: Drive) -> Entry:
    """Analyse one drive in a prepared process."""
    return _ANALYSTS[0].analyse(drive)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
