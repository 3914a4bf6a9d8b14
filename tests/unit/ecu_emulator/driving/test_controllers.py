"""Pedal, feet, engine and shift map: what each promises by itself."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.driving.parameters import nominal_driving
from ecu_emulator.driving.trip import DriveConditions
from ecu_emulator.errors import ConfigError
from ecu_emulator.plant.state import Col

DRIVING = nominal_driving()


def test_feet_move_no_faster_than_feet_and_never_press_both(town: FloatArray, sport: FloatArray) -> None:
    for rows in (town, sport):
        pedal, brake_m_s2 = rows[:, Col.PEDAL], rows[:, Col.BRAKE]
        assert np.abs(np.diff(pedal)).max() * 1000.0 <= DRIVING.driver.pedal_release_per_s + 1.0e-6
        assert np.abs(np.diff(brake_m_s2)).max() * 1000.0 <= DRIVING.driver.brake_press_m_s3 + 1.0e-6
        assert not ((pedal > 0.0) & (brake_m_s2 > 0.0)).any()
        assert pedal.min() >= 0.0
        assert pedal.max() <= 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"oil_k": 100.0}, "oil_k"),
        ({"coolant_k": float("nan")}, "coolant_k"),
        ({"dt_s": 3.0e-4}, "dt_s"),
        ({"dt_s": 1.7e-4}, "divide 1 ms"),
        ({"whim_ratio": 1.5}, "whim_ratio"),
    ],
)
def test_conditions_outside_their_ranges_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        DriveConditions(**changes)  # type: ignore[arg-type]  # all of them are numbers
