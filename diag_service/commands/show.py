"""``diag-service show``: everything that a store holds of one shift."""

import sys
from types import SimpleNamespace

from diag_service.console.terminal import PeopleConsole
from diag_service.diagnosis.results import dump
from diag_service.report.history import shift_lines
from diag_service.service.stopping import Controls
from diag_service.store import StoreReader


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Tell of a shift."""
    del controls
    with StoreReader.open(options.store) as store:
        record = store.record(options.shift)
    if options.json:
        sys.stdout.write(dump(record) + "\n")
        return
    console = PeopleConsole()
    for line in shift_lines(record):
        console.print(line)
