"""The messages that driving added: logs and databases from before them mean what they meant."""

from pathlib import Path

import numpy as np
import pytest

import canlog
from dbc.contract import DBC_PATH
from ecu_emulator.drive.recording import Drive
from ecu_emulator.driving.indices import DriveState, EngineState
from ecu_emulator.log_formats.record import open_log
from tests.support.in_process import ended as run
from tests.support.road import START_AND_STOP, road_scenario
from tests.support.service import Record

BEFORE = Path(__file__).parents[1] / "data" / "dct-before-driving.dbc"
NOT_AVAILABLE = 15


@pytest.fixture(name="road_log", scope="module")
def _road_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("road") / "road.log"
    with open_log(path) as log:
        for stretch in Drive(road_scenario(), planned=iter([START_AND_STOP])).stretches(10.0):
            log.write(stretch.frames)
    return path


def signals(log: Path, database: Path) -> dict[str, canlog.Samples]:
    return canlog.read(log, database).signals()


def without_stream(shift: Record) -> Record:
    return {key: value for key, value in shift.items() if key != "stream"}  # it stands for the database, too


def test_the_service_estimates_the_same_with_either_database(road_log: Path, tmp_path: Path) -> None:
    before, now = (
        run("analyze", road_log, "--dbc", database, "--profile", "dct", "--json") for database in (BEFORE, DBC_PATH)
    )
    assert len(before.shifts) >= 2
    assert [without_stream(shift) for shift in now.shifts] == [without_stream(shift) for shift in before.shifts]


def test_the_bus_says_which_gear_each_shaft_has_and_what_the_car_does(road_log: Path) -> None:
    said = signals(road_log, DBC_PATH)
    gears = [said[f"TCU_Drive.InputShaft{shaft}Gear"].value for shaft in (1, 2)]
    is_known = gears[0] != NOT_AVAILABLE
    assert set(gears[0][is_known]) <= {0, 1, 3, 5}
    assert set(gears[1][is_known]) <= {0, 2, 4, 6}
    shift = said["TCU_Shift.CurrentGear"]
    when_ns = said["TCU_Drive.DriveState"].t_ns
    current = shift.value[np.searchsorted(shift.t_ns, when_ns, side="right") - 1][is_known]
    state = said["TCU_Drive.DriveState"].value[is_known]
    own = np.where(current % 2 == 1, gears[0][is_known], gears[1][is_known])
    is_in_gear = state == DriveState.IN_GEAR
    np.testing.assert_array_equal(own[is_in_gear], current[is_in_gear])
    assert {DriveState.STANDSTILL, DriveState.LAUNCHING, DriveState.IN_GEAR, DriveState.CHANGING} <= set(state)
    engine = said["ECM_State.EngineState"].value
    assert EngineState.FIRING in engine
    assert set(engine) <= {*EngineState, NOT_AVAILABLE}
