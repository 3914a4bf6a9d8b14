"""On a live bus a still signal is taken as absent after three gear changes, and read again as soon as it moves."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from canlog.arrays import Series
from canlog.database.loading import load_database
from canlog.frames import FrameBatch
from clutch_model.calibration import nominal_calibration
from clutch_results.records import Tier
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import Drive as EmulatedDrive
from tests.support.builders import drive_scenario
from tests.support.recode import Drive, drive_of, recoded
from tests.support.wire import received

DATA = Path(__file__).parents[3] / "data"
DATABASE, PROFILE = load_database(DATA / "carmaker.dbc"), load_profile(DATA / "carmaker.toml")
ROLLED_M = 0.09
CYCLE_NS = 60 * 10**9
STILL = frozenset({Signal.INPUT_SPEED, Signal.CURRENT_GEAR})


@cache
def drive() -> Drive:
    frames = (received(stretch.frames) for stretch in EmulatedDrive(drive_scenario()).stretches(10.0))
    found = drive_of(frames)
    output = found[Signal.OUTPUT_SPEED]
    return {**found, Signal.VEHICLE_SPEED: replace(output, value=ROLLED_M * output.value)}


def still(series: Series) -> Series:
    return replace(series, value=np.zeros(len(series.value)))


def frames(signals: frozenset[Signal], later_ns: int = 0) -> FrameBatch:
    """Return the frames of a drive in which some signals stand at zero."""
    changed = {signal: still(series) if signal in signals else series for signal, series in drive().items()}
    rows = recoded(changed, DATABASE, PROFILE)
    return FrameBatch(
        t_ns=np.array([t_ns + later_ns for t_ns, _, _ in rows], np.int64),
        can_id=np.array([message.frame_id for _, message, _ in rows], np.uint32),
        length=np.array([len(payload) for _, _, payload in rows], np.uint8),
        data=np.array([list(payload.ljust(8, b"\0")) for _, _, payload in rows], np.uint8),
    )


def fed(stages: Stages, batch: FrameBatch, step: int = 400) -> list[Event]:
    return [event for first in range(0, len(batch), step) for event in stages.segment(batch[first : first + step])]


def test_it_is_absent_after_three_changes_and_read_again_when_it_moves() -> None:
    said = list[str]()
    stages = Stages(Decoder(DATABASE, PROFILE), nominal_calibration())
    assert stages.reach.tier is Tier.TORQUE
    stages.judge_liveness(said.append)
    events = fed(stages, frames(STILL))
    assert stages.decoder.absent == STILL
    assert [text.split(" is ")[0] for text in said] == ["GE_Wellen.GE_Eingangsdrehzahl", "GE_Gang.GE_Gang_Ist"]
    assert stages.capability().tier is not Tier.TORQUE
    assert 3 <= len(events) < 10  # the first three are what the gears are missed by
    assert [event.number for event in events] == [*range(1, len(events) + 1)]
    more = [*fed(stages, frames(frozenset(), CYCLE_NS)), *stages.flush()]
    assert stages.decoder.absent == frozenset()
    assert said[2:] == [
        "GE_Gang.GE_Gang_Ist moves: it is read again",
        "GE_Wellen.GE_Eingangsdrehzahl moves: it is read again",
    ]
    assert stages.reach.tier is Tier.TORQUE
    assert len(more) >= 10
    numbers = [event.number for event in (*events, *more)]
    assert numbers == [*range(1, len(numbers) + 1)]


def test_without_being_asked_nothing_is_absent() -> None:
    stages = Stages(Decoder(DATABASE, PROFILE), nominal_calibration())
    assert fed(stages, frames(STILL)) == []
    assert stages.decoder.absent == frozenset()


def test_a_standing_car_is_read_as_ever() -> None:
    said = list[str]()
    stages = Stages(Decoder(DATABASE, PROFILE), nominal_calibration())
    stages.judge_liveness(said.append)
    fed(stages, frames(STILL | {Signal.VEHICLE_SPEED, Signal.TARGET_GEAR}))
    assert (said, stages.decoder.absent) == ([], frozenset())
