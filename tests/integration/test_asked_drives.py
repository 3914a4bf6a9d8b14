"""Drives whose clutch pressures were asked for: analysed from the recorded dialogue, alone and beside broadcasts."""

import asyncio
import json
import re
from pathlib import Path

import can
import numpy as np
import pytest

import diag_service
from canlog.frames import EXTENDED_FLAG, join
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from clutch_results.records import ShiftResult
from diag_service.mapping.interpretation import interpret
from diag_service.service.stages import Stages
from ecu_emulator.cli import main as emulator
from tests.support.asked import DSG, asked_profile, dialogue_of, merged, write_candump
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.recode import Drive, drive_of

ON_THE_BUS = ("engine_speed_rad_s", "hub_speed_rad_s", "current_gear", "target_gear")
MINUTE_NS = 60_000_000_000
BROADCAST = """
engine_speed_rad_s = { message = "ECM_TorqueSpeed", signal = "EngineSpeed" }
hub_speed_rad_s = { message = "TCU_InputSpeeds", signal = "ClutchHubSpeed" }
current_gear = { message = "TCU_Shift", signal = "CurrentGear" }
target_gear = { message = "TCU_Shift", signal = "TargetGear" }
"""


@pytest.fixture(name="log", scope="module")
def _log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("asked") / "drive.log"
    assert emulator(["record", str(path), "--scenario", "case2", "--cycles", "1", "--seed", "7"]) == 0
    return path


@pytest.fixture(name="drive", scope="module")
def _drive(log: Path) -> Drive:
    return drive_of(log)


def beginning(drive: Drive, duration_ns: int) -> Drive:
    begun_ns = min(int(one.t_ns[0]) for one in drive.values())
    return {signal: one.between(0, begun_ns + duration_ns) for signal, one in drive.items()}


def piecewise(log: Path, profile: Path) -> list[float]:
    """Return the friction that the events of a log give if its frames come few by few, as a live bus gives them."""
    calibration = nominal_calibration()
    decoder = interpret(None, profile).decoder()
    stages = Stages(decoder, calibration)
    frames = join(list(read_log(log)))
    found = [one for at in range(0, len(frames), 97) for one in stages.feed(frames[at : at + 97])]
    found += [stages.conclude(event) for event in stages.flush()]
    return [one.estimate.friction.mu_c for one in found if one.estimate.friction is not None]


@pytest.mark.parametrize(("is_mixed", "is_defined"), [(True, False), (False, True)])
def test_friction_is_found_from_answers_alone_and_beside_broadcast_frames(
    log: Path, drive: Drive, *, is_mixed: bool, is_defined: bool
) -> None:
    text = DSG
    if is_mixed:
        text = "\n".join(line for line in DSG.splitlines() if not line.startswith(ON_THE_BUS)) + BROADCAST
    profile = asked_profile(log.parent, text)
    dialogue = dialogue_of(drive, profile, np.random.default_rng(1), is_defined=is_defined)
    asked = log.with_name("asked.log")
    write_candump(asked, merged(*read_log(log), dialogue) if is_mixed else dialogue)
    profile_path = log.with_name("asked.toml")
    run = ended("analyze", asked, "--profile", profile_path, "--json")
    assert run.status == 0, run.err
    valid = [one for one in run.records if "from_gear" in one and one["status"] == "valid"]
    assert len(valid) >= 8
    frames = run.records[-1]["frames"]
    assert frames["decoded"] + frames["ignored"] == frames["on_bus"]
    assert [one["friction"]["mu_c"] for one in valid] == piecewise(asked, profile_path)
    truth = next(json.loads(line) for line in log.with_suffix(".log.truth.jsonl").read_text("utf-8").splitlines())
    for one in valid:
        friction, true = one["friction"], truth["mu_c"][one["clutch"] - 1]
        assert abs(friction["mu_c"] - true) < 4.0 * friction["std_mu_c"]


@pytest.mark.parametrize(
    ("wrong", "text"),
    [(("scale = 0.05", "scale = 0.025"), "of what this type has new"), (("0x38EB", "0x38EA"), "none of 3 events fits")],
)
def test_a_profile_for_another_car_is_found_out_and_nothing_is_estimated(
    log: Path, drive: Drive, wrong: tuple[str, str], text: str
) -> None:
    dialogue = dialogue_of(beginning(drive, MINUTE_NS), asked_profile(log.parent), np.random.default_rng(1))
    asked_profile(log.parent, DSG.replace(wrong[0], "#").replace(wrong[1], wrong[0]).replace("#", wrong[1]))
    asked = log.with_name("doubted.log")
    write_candump(asked, dialogue)
    run = ended("analyze", asked, "--profile", log.with_name("asked.toml"), "--json")
    assert "warning: nothing is estimated: " in run.err
    assert text in run.err
    assert not [one for one in run.records if one.get("status") == "valid"]


def numbered(key: str) -> str:
    """Return the profile with numbers of one byte in place of its identifiers."""
    numbers = {text: f"{key} = {at}" for at, text in enumerate(dict.fromkeys(re.findall(r"did = \w+", DSG)), 16)}
    return re.sub(r"did = \w+", lambda found: numbers[found[0]], DSG)


@pytest.mark.parametrize(
    ("text", "together", "is_defined"), [(DSG, 8, True), (numbered("local"), 1, False)], ids=["define", "local"]
)
async def test_a_bus_on_which_somebody_asks_says_what_its_recording_says(
    log: Path, drive: Drive, text: str, together: int, *, is_defined: bool
) -> None:
    profile, half, answer_s = asked_profile(log.parent, text), beginning(drive, MINUTE_NS // 2), (0.003, 0.005)
    dialogue = dialogue_of(
        half, profile, np.random.default_rng(1), together=together, is_defined=is_defined, answer_s=answer_s
    )
    asked, path = log.with_name("recorded.log"), log.with_name("asked.toml")
    write_candump(asked, dialogue)
    live = await live_results(asked, path)
    assert len(live) >= 3
    assert any(one.estimate.friction is not None for one in live)


async def live_results(log: Path, profile: Path) -> list[ShiftResult]:
    """Return what a bus says on which a recording is played, which must be what the recording says."""
    recorded, frames = diag_service.analyze(log, profile=profile), join(list(read_log(log)))
    found: list[ShiftResult] = []
    with can.Bus("asked drive", "virtual", preserve_timestamps=True) as near, can.Bus("asked drive", "virtual") as far:
        async with asyncio.timeout(HANG_S), diag_service.diagnose(far, profile=profile) as live:
            for t_ns, can_id, length, data in zip(
                frames.t_ns.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
            ):
                is_long = bool(can_id & int(EXTENDED_FLAG))
                near.send(
                    can.Message(
                        timestamp=t_ns / 1e9,
                        arbitration_id=can_id & 0x1FFF_FFFF,
                        is_extended_id=is_long,
                        data=data[:length].tobytes(),
                    )
                )
            async for result in live:
                found.append(result)
                if len(found) == len(recorded.results) - 1:  # the last one waits for more of the bus, or its end
                    break
    told = recorded.results[: len(found)]
    assert [one.estimate for one in found] == [one.estimate for one in told]
    return found
