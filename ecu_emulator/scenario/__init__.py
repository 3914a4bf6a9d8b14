"""Scenarios: everything that decides what one drive puts on the bus; here what can be driven, by name."""

import enum

__all__ = ["DriveName"]


class DriveName(enum.StrEnum):
    CYCLE = "cycle"  # 1-2-3-4-5-6-5-4-3-2-1 with a warm transmission, as on a test bench
    WLTC = "wltc"
    UDDS = "udds"
    HWFET = "hwfet"
    US06 = "us06"
    CITY = "city"  # seeded traffic: lights, queues, corners
    DAY = "day"  # trips through city, country and on the motorway, the car parked in between
