"""The logs of one drive from their files to everyone who hears of results."""

import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from canlog.logs.reading import Watch
from diag_service.delivery import Reporter
from diag_service.diagnosis.summary import Summary
from diag_service.service.application import opened_store, outbox_of
from diag_service.service.drive import open_drive, stream_of_drive
from diag_service.service.recorded import run_logs, run_logs_and_send
from diag_service.service.session import Session
from diag_service.service.stopping import Trigger
from diag_service.service.tasks import run_to_end
from diag_service.settings.config import DiagnosisConfig

_LOG = logging.getLogger(__name__)


def _nobody(_stream: str) -> None:
    pass


def run_recorded(
    config: DiagnosisConfig,
    paths: Sequence[Path],
    store_path: Path | None,
    reporter: Reporter,
    stop: Trigger,
    *,
    watch: Watch | None = None,
    name_stream: Callable[[str], None] = _nobody,
) -> Summary:
    """Diagnose the logs of a drive; the summary says whether it was all of it.

    ``watch`` hears how far the reading is, ``name_stream`` what the stream of the drive is called.
    """
    meaning = config.interpretation()
    decoder = meaning.decoder()
    with ExitStack() as opened:
        logs = open_drive(paths, is_strict=config.is_strict, is_stopped=lambda: stop.is_set, watch=watch)
        for log in logs:
            opened.callback(log.reader.close)
        stream = stream_of_drive((log.path for log in logs), meaning.files)
        name_stream(stream)
        store = opened.enter_context(opened_store(config, store_path, keeps_results=False))
        session = Session(config, decoder, store, stream, reporter)
        outbox = outbox_of(config, store, session, is_live=False)
        if outbox is None:
            return run_logs(logs, session, stop=stop)
        summary = run_to_end(run_logs_and_send(logs, session, stop=stop, outbox=outbox))
        if summary.unpublished_count and store_path is None:
            _LOG.warning("%d results were not delivered and are not kept; --store would", summary.unpublished_count)
        return summary
