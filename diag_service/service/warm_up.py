"""What numba has to compile is compiled before frames come that would have to wait for it."""

from pathlib import Path
from typing import Final

from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages

RECORDING: Final = Path(__file__).with_name("warm_up.log.xz")  # two seconds of the emulator, with one upshift


def warm_up() -> None:
    """Diagnose a recording of two seconds."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration)
    for batch in read_log(RECORDING):
        stages.feed(batch)
