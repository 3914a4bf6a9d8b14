"""What the engine controller may do otherwise than the service believes."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.plant.state import Col
from ecu_emulator.sensing import Installation, Readings, SensorSuite
from tests.unit.ecu_emulator.rows import made_up_rows
from tests.unit.ecu_emulator.sensing.test_sensors import PLACE, schedule


def read_at(place: Installation, rows: FloatArray) -> Readings:
    suite = SensorSuite(
        schedules=[schedule("engine_speed_rad_s", "engine_torque_nm", "hub_speed_rad_s")],
        sensors={},
        installation=place,
        startup_s={},
        seed=1,
    )
    (reading,) = suite.read(rows)
    return reading


def test_a_sampled_engine_speed_is_that_of_the_instant() -> None:
    rows = made_up_rows(1000)
    plain, sampled = (read_at(replace(PLACE, engine_speed_is_sampled=flag), rows) for flag in (False, True))
    assert sampled.values["engine_speed_rad_s"] == pytest.approx(rows[::10, Col.ENGINE_SPEED], abs=0.0)
    assert np.max(np.abs(plain.values["engine_speed_rad_s"] - rows[::10, Col.ENGINE_SPEED])) > 0.2
    for quantity in ("engine_torque_nm", "hub_speed_rad_s"):
        assert np.array_equal(plain.values[quantity], sampled.values[quantity])
