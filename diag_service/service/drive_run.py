"""The logs of one drive from their files to everyone who hears of results."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from canlog.logs.reading import Watch
from diag_service.delivery import Reporter
from diag_service.diagnosis.summary import Summary
from diag_service.mapping.interpretation import Interpretation
from diag_service.service.application import opened_store, outbox_of
from diag_service.service.drive import open_drive, stream_of_drive
from diag_service.service.recorded import run_logs, run_logs_and_send
from diag_service.service.session import Session
from diag_service.service.stopping import Trigger
from diag_service.service.tasks import run_to_end
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import NoStore

_LOG = logging.getLogger(__name__)


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
    meaning: Interpretation | None = None,  # of the frames, where it is at hand: that of the configuration
) -> RecordedRun:
    """Diagnose the logs of a drive.

    Raises what ``open_drive`` and ``opened_store`` raise, ConfigError if the frames cannot be interpreted.
    """
    meaning = meaning or config.interpretation()
    decoder = meaning.decoder()
    with open_drive(
        paths, is_strict=config.is_strict, is_stopped=lambda: stop.is_set, watch=watch, columns=config.columns
    ) as logs:
        stream = stream_of_drive((log.path for log in logs), meaning.files)
        if store_path is None and config.broker is None:
            session = Session(config, decoder, NoStore(), stream, reporter)
            return RecordedRun(stream=stream, summary=run_logs(logs, session, stop=stop))
        with opened_store(config, store_path, keeps_results=False) as store:
            session = Session(config, decoder, store, stream, reporter)
            outbox = outbox_of(config, store, session, is_live=False)
            if outbox is None:
                return RecordedRun(stream=stream, summary=run_logs(logs, session, stop=stop))
            summary = run_to_end(run_logs_and_send(logs, session, stop=stop, outbox=outbox))
    if summary.unpublished_count and store_path is None:
        _LOG.warning(
            "%d results were not delivered and are not kept; --store would keep them", summary.unpublished_count
        )
    return RecordedRun(stream=stream, summary=summary)
