"""Short drives on the road for tests."""

from dataclasses import replace

import numpy as np

from ecu_emulator.driving.journey import PlannedTrip
from ecu_emulator.driving.traffic import SpeedTrace
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario import Scenario
from tests.support.builders import drive_scenario


def short_trip(name: str = "start and stop", parked_s: float = 0.0) -> PlannedTrip:
    """Return a trip of half a minute: off to 50 km/h, through a few gears, and back to rest."""
    t_s = np.array([0.0, 2.0, 12.0, 18.0, 28.0, 32.0])
    speed_m_s = np.array([0.0, 0.0, 14.0, 14.0, 0.0, 0.0])
    trace = SpeedTrace(name=name, t_s=t_s, speed_m_s=speed_m_s, grade_ratio=np.zeros(len(t_s)))
    return PlannedTrip(trace=trace, parked_s=parked_s)


def road_scenario(name: str = "noise_only") -> Scenario:
    """Return a shipped scenario that is driven on the road."""
    return replace(drive_scenario(name), drive=DriveName.CITY)
