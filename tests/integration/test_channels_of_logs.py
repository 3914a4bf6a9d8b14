"""Logs of one drive number their channels each in its own way."""

from pathlib import Path

from clutch_model.calibration import nominal_calibration
from dbc.contract import DBC_PATH
from diag_service.decoding.mapping import Decoder
from diag_service.definitions.database import load_database
from diag_service.definitions.profile import load_profile
from diag_service.estimation import Belief
from diag_service.judgement.condition import ConditionMemory
from diag_service.runs.drive import open_drive
from diag_service.runs.recorded import events
from diag_service.runs.stages import Stages
from diag_service.stopping import Trigger


def test_a_second_log_with_another_channel_contributes(drive_log: Path, tmp_path: Path) -> None:
    lines = drive_log.read_bytes().splitlines(keepends=True)
    half = len(lines) // 2
    monday, tuesday = tmp_path / "monday.log", tmp_path / "tuesday.log"
    monday.write_bytes(b"".join(lines[:half]))
    tuesday.write_bytes(b"".join(line.replace(b"can0", b"can1", 1) for line in lines[half:]))
    decoder = Decoder(load_database(DBC_PATH), load_profile())
    calibration = nominal_calibration()
    stages = Stages(decoder, calibration, Belief.fresh(calibration), ConditionMemory.fresh())
    shifts = list(events(open_drive([monday, tuesday]), stages, Trigger()))
    counts = stages.frame_counts()
    assert counts.rejected.get("other_channel", 0) == 0
    assert counts.decoded == len(lines)
    assert len(shifts) == 3
