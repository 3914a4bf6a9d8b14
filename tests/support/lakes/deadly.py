"""The service, with one thing more: a log whose name says so ends the process that analyses it.

Usage: ``python -m tests.support.lakes.deadly analyze ...``, whose processes import this module as well, or
``dask worker --preload tests.support.lakes.deadly ...``.
"""

import os
import sys

import diag_service.cli
from diag_service.batch.drives import DriveLogs
from diag_service.batch.tables import Entry
from diag_service.batch.worker import Analyst
from diag_service.stopping import Trigger

DEADLY = "deadly"  # in the name of the log
_ANALYSE = Analyst.analyse


def analyse(analyst: Analyst, drive: DriveLogs, stop: Trigger | None = None) -> Entry:
    """Analyse a drive as ever, or die."""
    if DEADLY in drive.name:
        os._exit(9)
    return _ANALYSE(analyst, drive, stop)


Analyst.analyse = analyse  # type: ignore[assignment, method-assign]  # in every process of a worker

if __name__ == "__main__":
    sys.exit(diag_service.cli.main())
