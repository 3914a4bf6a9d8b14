"""``diag-service report``: the logs of a drive, or a store, as one HTML page."""

import sys
from types import SimpleNamespace

from diag_service.console.reading import ReadingLine
from diag_service.errors import ConfigError
from diag_service.report.findings import Findings, findings_of_logs, findings_of_store
from diag_service.report.page import page_of, write_page
from diag_service.service.drive import insist
from diag_service.service.session import utc_now
from diag_service.service.stopping import Controls
from diag_service.settings.config import diagnosis_config
from diag_service.store import is_store
from program_io.legible import legible
from program_io.overwriting import replacement_refusal


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Write the report, and say where and how large it is."""
    if options.output.suffix.lower() not in {".html", ".htm"}:
        raise ConfigError(f"{options.output}: a report is written as .html")
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    found = _findings(options, controls)
    size_bytes = write_page(options.output, page_of(found, utc_now()))
    sys.stdout.write(f"{legible(str(options.output))}: {size_bytes / 1000.0:.0f} kB\n")
    if found.summary is not None:
        insist(found.summary.gaps, found.summary.contributions, is_strict=False)


def _findings(options: SimpleNamespace, controls: Controls) -> Findings:
    named = options.vehicle
    config = diagnosis_config(options)
    stores = [path for path in options.logs if is_store(path)]
    if not stores:
        with ReadingLine() as line:
            return findings_of_logs(config, options.logs, controls.stop, watch=line.watch)
    if len(options.logs) > 1:
        raise ConfigError(f"{stores[0]} is a store: a report is of one store, or of the logs of one drive")
    return findings_of_store(stores[0], named or config.calibration.vehicle, config.calibration)
