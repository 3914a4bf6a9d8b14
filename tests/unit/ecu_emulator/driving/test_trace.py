"""Speed traces check what they are made of."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.driving.traffic import SpeedTrace
from ecu_emulator.errors import EmulatorConfigError


def trace(**changes: FloatArray) -> SpeedTrace:
    columns = {"t_s": np.array([0.0, 10.0, 20.0]), "speed_m_s": np.array([0.0, 10.0, 10.0]), "grade_ratio": np.zeros(3)}
    return SpeedTrace(name="made up", **{**columns, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t_s": np.array([0.0, 10.0])}, "needs two or more points"),
        ({"speed_m_s": np.array([0.0, np.nan, 0.0])}, "must be finite"),
        ({"t_s": np.array([0.0, 10.0, 10.0])}, "must begin at 0 and rise"),
        ({"t_s": np.array([1.0, 10.0, 20.0])}, "must begin at 0 and rise"),
        ({"speed_m_s": np.array([0.0, -1.0, 0.0])}, "speeds must be"),
        ({"speed_m_s": np.array([0.0, 100.0, 0.0])}, "speeds must be"),
        ({"grade_ratio": np.array([0.0, 0.3, 0.0])}, "grades must be"),
    ],
)
def test_what_is_no_trace_is_refused(changes: dict[str, FloatArray], message: str) -> None:
    with pytest.raises(EmulatorConfigError, match=message):
        trace(**changes)
