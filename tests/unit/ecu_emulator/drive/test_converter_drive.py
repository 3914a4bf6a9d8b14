"""A car with a torque converter on the bus: its frames say what was driven, the same ones again, and its truth."""

from collections.abc import Sequence

import numpy as np
import pytest

from canlog.e2e import profile1
from canlog.e2e.message_contract import message_contracts
from dbc.contract import load_contract
from ecu_emulator.bus.frames import EncodedFrames, merge
from ecu_emulator.drive.recording import Drive, DriveStretch
from ecu_emulator.scenario.scenario import Scenario
from ecu_emulator.scenario.scenario_file import load_scenario

DATABASE = load_contract("lockup")
SCENARIO = load_scenario("lockup")
MOST_S = 100.0


def stretches(scenario: Scenario, length_s: float, until_s: float) -> tuple[list[DriveStretch], Drive]:
    drive, found = Drive(scenario), list[DriveStretch]()
    for stretch in drive.stretches(length_s):
        found.append(stretch)
        if stretch.end_s >= until_s:
            break
    return found, drive


def frames_of_all(found: Sequence[DriveStretch]) -> EncodedFrames:
    return merge([one.frames for one in found])


def column(frames: EncodedFrames, message: str, name: str) -> list[float]:
    known = DATABASE.get_message_by_name(message)
    payloads = frames.data[frames.can_id == known.frame_id]
    decoded = [known.decode_simple(one.tobytes(), decode_choices=False) for one in payloads]
    return [float(one[name]) for one in decoded]  # type: ignore[arg-type]  # numbers, without choices


def test_frames_say_what_was_driven() -> None:
    frames = frames_of_all(stretches(SCENARIO, 10.0, MOST_S)[0])
    contracts = message_contracts(DATABASE)
    assert set(frames.can_id.tolist()) == {one.can_id for one in contracts.values()}
    for one in contracts.values():
        payloads = frames.data[frames.can_id == one.can_id]
        assert one.data_id is not None
        assert profile1.crc_is_valid(payloads, profile1.data_id_remainder(one.data_id)).all()
    engine, turbine = column(frames, "ECM_TorqueSpeed", "EngineSpeed"), column(frames, "TCU_Turbine", "TurbineSpeed")
    state, pressure = column(frames, "TCU_LockUp", "LockUpState"), column(frames, "TCU_LockUp", "LockUpPressure")
    slip_rpm = np.array([one - other for one, other, now in zip(engine, turbine, state, strict=False) if now == 2.0])
    assert len(slip_rpm) > 1000
    assert 20.0 < float(np.median(slip_rpm)) < 60.0
    assert max(pressure[k] for k, now in enumerate(state) if now == 2.0) > 1.0
    gear, output = np.array(column(frames, "TCU_Gear", "CurrentGear")), column(frames, "TCU_Turbine", "OutputSpeed")
    is_fifth = (gear[: len(output)] == 5.0) & (np.array(column(frames, "TCU_Gear", "TargetGear"))[: len(output)] == 5.0)
    assert np.median(np.array(turbine)[is_fifth] / np.array(output)[is_fifth]) == pytest.approx(1.285, rel=0.01)
