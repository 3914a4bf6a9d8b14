"""What one version of this project takes to decode a log, to find its shifts, and to have its results.

Run by its path, so that the packages it measures are those of the folder that PYTHONPATH names:

    PYTHONPATH=FOLDER python -P timed_hour.py LOG

It prints one line of JSON: processor time of each step [s], and how many events there were.
"""

import json
import sys
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.batch.drives import drive_of
from diag_service.batch.journal import Entry
from diag_service.batch.worker import Analyst
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from diag_service.settings.config import DiagnosisConfig


def decode(log: Path) -> None:
    """Read a log and make columns of all its frames."""
    decoder = Decoder(load_contract(), load_profile())
    with closing(read_log(log)) as reader:
        for batch in reader:
            for _ in decoder.stream(batch):
                pass


def find_shifts(log: Path) -> None:
    """Do the same and cut out what shifts, launches and creeps are made of."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    with closing(read_log(log)) as reader:
        for batch in reader:
            stages.segment(batch)
    stages.flush()


def analyse(log: Path) -> Entry:
    """Return what the program makes of a log in a folder, ready to be written."""
    return Analyst(DiagnosisConfig(vehicle="vehicle", calibration=nominal_calibration())).analyse(drive_of([log]))


def took_s(work: Callable[[], object]) -> float:
    """Return the processor time of some work [s]."""
    began_s = time.process_time()
    work()
    return time.process_time() - began_s


def main() -> None:
    """Measure and print; the first pass compiles what is not compiled."""
    log = Path(sys.argv[1])
    entry = analyse(log)
    took = {work.__name__: took_s(partial(work, log)) for work in (decode, find_shifts, analyse)}
    sys.stdout.write(json.dumps({**took, "events": len(entry.shifts)}) + "\n")


if __name__ == "__main__":
    main()
