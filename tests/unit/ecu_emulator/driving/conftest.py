"""Drives that several tests look at."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.driving.traffic import SpeedTrace
from tests.unit.ecu_emulator.driving.drives import COLD_K, driven, trace

TOWN = trace((0, 0), (4, 0), (14, 13), (24, 14), (32, 4), (36, 9), (44, 0), (50, 0))
SPORT = trace((0, 0), (1, 0), (11, 15), (24, 15), (25, 30), (33, 30), (45, 28), (50, 8), (53, 8))


@pytest.fixture(scope="package")
def town_trace() -> SpeedTrace:
    """Return a start, two accelerations, a slow-down and a stop."""
    return TOWN


@pytest.fixture(scope="package")
def town(town_trace: SpeedTrace) -> FloatArray:
    """Return the rows of the warm drive through town."""
    return _frozen(driven(town_trace))


@pytest.fixture(scope="package")
def cold_town(town_trace: SpeedTrace) -> FloatArray:
    """Return the rows of the same drive at -10 degC."""
    return _frozen(driven(town_trace, oil_k=COLD_K, coolant_k=COLD_K, ambient_k=COLD_K))


@pytest.fixture(scope="package")
def sport() -> FloatArray:
    """Return the rows of a drive whose driver floors the pedal at speed and brakes hard."""
    return _frozen(driven(SPORT))


def _frozen(rows: FloatArray) -> FloatArray:
    rows.flags.writeable = False
    return np.asarray(rows)
