"""Scenarios: everything that decides what a drive puts on the bus; here what can be driven, and within which limits."""

import enum
from typing import Final

OIL_RANGE_DEGC: Final = (-15.0, 130.0)
MASS_RANGE_KG: Final = (900.0, 3500.0)
DELAY_RANGE_S: Final = (0.0, 3600.0)
MOST_PARKED_S: Final = 86_400.0
PARKED_RANGE_S: Final = (0.0, MOST_PARKED_S)
LIVE_PARKED_S: Final = 10.0


class DriveName(enum.StrEnum):
    CYCLE = "cycle"  # 1-2-3-4-5-6-5-4-3-2-1 with a warm transmission, as on a test bench
    WLTC = "wltc"
    UDDS = "udds"
    HWFET = "hwfet"
    US06 = "us06"
    CITY = "city"  # seeded traffic: lights, queues, corners
    DAY = "day"  # trips through city, country and on the motorway, the car parked in between
