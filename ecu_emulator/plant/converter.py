"""Torque converter: its characteristic over the speed ratio, both ways; docs/model.md eqs. (C1)-(C3)."""

from typing import Final, NamedTuple

import numpy as np

from canlog.jit import part
from clutch_model.calibration import Converter

PLACES: Final = 101  # of the characteristic, evenly from stall to equal speeds
_LAG_S: Final = (
    0.05  # of the torque behind its map: the oil in the torus has to change its speed (Hrovat and Tobler 1985)
)


class ConverterLaw(NamedTuple):
    """A converter as the kernels take it, or none."""

    is_there: int
    capacities_nm_s2: tuple[float, ...]  # torque of the impeller over its speed squared
    torque_ratios: tuple[float, ...]
    lag_s: float


def converter_law(converter: Converter | None) -> ConverterLaw:
    """Return the characteristic on an even grid; straight lines between the points that are told."""
    if converter is None:
        return ConverterLaw(0, (0.0,) * PLACES, (0.0,) * PLACES, _LAG_S)
    grid = np.linspace(0.0, 1.0, PLACES)
    capacities = np.interp(grid, converter.speed_ratios, converter.capacities_nm_s2)
    ratios = np.interp(grid, converter.speed_ratios, converter.torque_ratios)
    return ConverterLaw(1, tuple(capacities.tolist()), tuple(ratios.tolist()), _LAG_S)


@part
def _at(column: tuple[float, ...], speed_ratio: float) -> float:
    place = min(max(speed_ratio, 0.0), 1.0) * (PLACES - 1)
    index = min(int(place), PLACES - 2)
    return float(column[index] + (place - index) * (column[index + 1] - column[index]))


@part
def impeller_torque_nm(impeller_rad_s: float, turbine_rad_s: float, law: ConverterLaw) -> float:
    """Return the torque that the converter takes from the engine in the steady state [N m], eq. (C1).

    A turbine that is faster drives the impeller as a fluid coupling does, whose two wheels are alike.
    """
    if impeller_rad_s >= turbine_rad_s:
        if impeller_rad_s <= 0.0:
            return 0.0
        return _at(law.capacities_nm_s2, turbine_rad_s / impeller_rad_s) * impeller_rad_s * impeller_rad_s
    if turbine_rad_s <= 0.0:
        return 0.0
    return -_at(law.capacities_nm_s2, impeller_rad_s / turbine_rad_s) * turbine_rad_s * turbine_rad_s


@part
def torque_ratio(impeller_rad_s: float, turbine_rad_s: float, law: ConverterLaw) -> float:
    """Return the torque of the turbine over that of the impeller, eq. (C2): 1 on the overrun."""
    if impeller_rad_s <= 0.0 or turbine_rad_s >= impeller_rad_s:
        return 1.0
    return _at(law.torque_ratios, turbine_rad_s / impeller_rad_s)
