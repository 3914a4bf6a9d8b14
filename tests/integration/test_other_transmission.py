"""A seven-speed transmission, emulated and diagnosed: every gear change found, friction right, no fault."""

import json
from pathlib import Path

import pytest

import diag_service
from ecu_emulator import Emulator
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.recording import Drive
from ecu_emulator.scenario.scenario_file import load_scenario
from workshop.controller.controller import Controller
from workshop.controller.iso14229 import DtcStatus
from workshop.controller.monitoring import Monitoring
from workshop.controller.table import shipped_table
from workshop_tests.controller.test_monitors import STEP_S, sensed

CYCLES = 2
SHIFTS = 12  # of a cycle: 1-7-1
WARM_UP = 5  # looks, until all messages have been sent


@pytest.fixture(name="log", scope="module")
def _log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gs7") / "seven.log"
    Emulator("gs7", cycles=CYCLES, seed=11).record(path)
    return path


def test_a_seven_speed_is_diagnosed_by_its_own_description(log: Path) -> None:
    found = diag_service.analyze(log, calibration="gs7")
    assert found.shifts.column("status") == ["valid"] * CYCLES * SHIFTS
    assert {row["to_gear"] for row in found.shifts} == {1, 2, 3, 4, 5, 6, 7}
    truth = [json.loads(line) for line in Path(f"{log}.truth.jsonl").read_text(encoding="utf-8").splitlines()]
    mu_c = next(line["mu_c"] for line in truth if "mu_c" in line)
    for clutch, verdict in found.verdicts.items():
        friction = verdict.friction
        assert friction is not None
        assert abs(friction.mu_c - mu_c[clutch - 1]) < 3.0 * friction.std_mu_c
        assert verdict.condition is diag_service.Condition.GOOD


def test_the_controller_of_a_seven_speed_finds_no_fault_but_that_of_a_six_speed_would() -> None:
    frames = merge([stretch.frames for stretch in Drive(load_scenario("gs7")).stretches(60.0)])
    found = {}
    for transmission in ("gs7", "nominal"):
        controller = Controller(shipped_table(), values=dict, clock=lambda: 0.0, chance=bytes)
        monitoring = Monitoring(controller, transmission=transmission)
        for place, values in enumerate(sensed(frames)):
            if place >= WARM_UP:
                monitoring.judge(values, place * STEP_S)
        found[transmission] = [
            hex(number)
            for number, record in controller.state.memory.records.items()
            if record.status & DtcStatus.TEST_FAILED
        ]
    assert found["gs7"] == []
    assert found["nominal"] != []
