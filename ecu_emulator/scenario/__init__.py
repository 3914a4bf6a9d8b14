"""Scenarios: everything that decides what a drive puts on the bus; here what can be driven, and within which limits."""

import enum
import typing

__all__ = ["LIVE_PARKED_S", "MASS_RANGE_KG", "MOST_PARKED_S", "OIL_RANGE_DEGC", "PARKED_RANGE_S", "DriveName"]

OIL_RANGE_DEGC: typing.Final = (-15.0, 130.0)
MASS_RANGE_KG: typing.Final = (900.0, 3500.0)
MOST_PARKED_S: typing.Final = 86_400.0
PARKED_RANGE_S: typing.Final = (0.0, MOST_PARKED_S)
LIVE_PARKED_S: typing.Final = 10.0


class DriveName(enum.StrEnum):
    CYCLE = "cycle"  # 1-2-3-4-5-6-5-4-3-2-1 with a warm transmission, as on a test bench
    WLTC = "wltc"
    UDDS = "udds"
    HWFET = "hwfet"
    US06 = "us06"
    CITY = "city"  # seeded traffic: lights, queues, corners
    DAY = "day"  # trips through city, country and on the motorway, the car parked in between
