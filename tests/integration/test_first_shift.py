"""Nothing is left to the compiler once the service is ready: neither first frames nor first shift wait for it."""

import subprocess
import sys
from pathlib import Path

from tests.support.service import environment

COUNT = """
import gc
import sys
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from clutch_model.calibration import nominal_calibration
from dbc.contract import DBC_PATH, load_contract
from diag_service.mapping.decoder import Decoder
from canlog.database.loading import load_database
from diag_service.mapping.profile import load_profile
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.service.stages import Stages
from diag_service.service.bus_run import warm_up
from canlog.logs import read_log

PIECE = 500  # frames, as a live bus hands them over


def compiled():
    return {
        (one.py_func.__module__, one.py_func.__name__, str(signature))
        for one in gc.get_objects()
        if isinstance(one, Dispatcher) and one.py_func.__module__.startswith("diag_service")
        for signature in one.signatures
    }


batches = list(read_log(Path(sys.argv[1])))
calibration = nominal_calibration()
decoder = Decoder(load_contract(), load_profile())
stages = Stages(decoder, calibration)
warm_up()
before = compiled()
statuses = [
    found.estimate.status.value
    for batch in batches
    for first in range(0, len(batch), PIECE)
    for found in stages.feed(batch[first : first + PIECE])
]
print(statuses.count("valid"), sorted(compiled() - before))
"""


def test_the_first_shift_finds_everything_compiled(cycle_log: Path) -> None:
    asked = subprocess.run(
        (sys.executable, "-c", COUNT, cycle_log), check=True, capture_output=True, text=True, env=environment()
    )
    assert asked.stdout == "10 []\n"
