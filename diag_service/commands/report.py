"""``diag-service report``: the logs of a drive, or a store, as one HTML page."""

import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

from canlog.logs import STANDARD_INPUT
from canlog.logs.reading import Watch
from clutchdiag_io.legible import legible
from clutchdiag_io.overwriting import replacement_refusal
from diag_service.console.terminal import ReadingLine
from diag_service.errors import ConfigError
from diag_service.report.findings import Findings, findings_of_logs, findings_of_store
from diag_service.report.page import page_of, write_page
from diag_service.service.drive import insist
from diag_service.service.session import utc_now
from diag_service.service.stopping import Controls, Trigger
from diag_service.settings.config import DiagnosisConfig, diagnosis_config
from diag_service.store import is_store


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Write the report, and say where and how large it is."""
    check_name(options.output)
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    named, config = options.vehicle, diagnosis_config(options)  # which gives a vehicle without a name one
    with ReadingLine() as line:
        found = findings_of(config, options.logs, named, controls.stop, watch=line.watch)
        line.show("making the page")
        size_bytes = write_page(options.output, page_of(found, utc_now()))
    sys.stdout.write(f"{legible(str(options.output))}: {size_bytes / 1000.0:.0f} kB\n")
    if found.summary is not None:
        insist(found.summary.gaps, found.summary.contributions, is_strict=False)


def findings_of(
    config: DiagnosisConfig, paths: Sequence[Path], vehicle: str | None, stop: Trigger, *, watch: Watch | None = None
) -> Findings:
    """Return what a report is made of: the logs of a drive, or a store and which vehicle of it is meant."""
    stores = [path for path in paths if path != STANDARD_INPUT and is_store(path)]
    if not stores:
        return findings_of_logs(config, paths, stop, watch=watch)
    if len(paths) > 1:
        raise ConfigError(f"{stores[0]} is a store: a report is of one store, or of the logs of one drive")
    return findings_of_store(stores[0], vehicle or config.calibration.vehicle, config.calibration)


def check_name(path: Path) -> None:
    """Raise ConfigError unless a file is called as a page is."""
    if path.suffix.lower() not in {".html", ".htm"}:
        raise ConfigError(f"{path}: a report is written as .html")
