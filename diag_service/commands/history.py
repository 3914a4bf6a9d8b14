"""``diag-service history``: how the friction of each clutch went, from a store."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

from clutch_model.calibration import nominal_calibration
from diag_service.console.terminal import PeopleConsole
from diag_service.diagnosis.prognosis import Population, population_from
from diag_service.diagnosis.results import dump
from diag_service.errors import ConfigError
from diag_service.report.findings import findings_of_store
from diag_service.report.history import history_lines, history_records
from diag_service.service.stopping import Controls


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Tell the history of one vehicle, on the clutches that are asked for."""
    del controls
    if options.rows < 1:
        raise ConfigError(f"--rows must be 1 or more, got {options.rows}")
    population = None if options.peers is None else _population(options.peers)
    found = findings_of_store(options.store, options.vehicle, nominal_calibration())
    clutches = (1, 2) if options.clutch is None else (options.clutch,)
    if options.json:
        for record in history_records(found, clutches):
            sys.stdout.write(dump(record) + "\n")
        return
    console = PeopleConsole()
    for line in history_lines(found, clutches, most_rows=options.rows, population=population):
        console.print(line)


def _population(path: Path) -> Population:
    """Return what a fleet taught, as ``fleet-backend peers --write`` wrote it."""
    try:
        return population_from(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, RecursionError) as exc:
        raise ConfigError(f"{path}: {exc}") from exc
