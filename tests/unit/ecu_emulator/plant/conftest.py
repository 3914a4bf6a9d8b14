"""Drives that several tests look at."""

import pytest

from ecu_emulator.plant.course import DriveSettings
from ecu_emulator.plant.powertrain import Powertrain
from tests.support.cycles import LONGEST_CYCLE_S, FloatArray, powertrain


@pytest.fixture(scope="package")
def driven_cycle() -> tuple[Powertrain, FloatArray]:
    """Return an audited powertrain at the end of the nominal cycle, and all its rows."""
    train = powertrain(DriveSettings(), is_audited=True)
    rows = train.advance(LONGEST_CYCLE_S)
    rows.flags.writeable = False
    return train, rows
