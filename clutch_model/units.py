"""The only conversion factors of the project: what people and wires use, to and from SI. Floats or arrays."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Quantity = TypeVar("Quantity", float, FloatArray)

NS_PER_S = 1_000_000_000
_RAD_S_PER_RPM = math.pi / 30.0
_PA_PER_BAR = 1.0e5
_ICE_POINT_K = 273.15
_KM_H_PER_M_S = 3.6


def rad_s_from_rpm(speed_rpm: Quantity) -> Quantity:
    """Return an angular speed [rad/s]."""
    return speed_rpm * _RAD_S_PER_RPM


def rpm_from_rad_s(speed_rad_s: Quantity) -> Quantity:
    """Return a speed in revolutions per minute."""
    return speed_rad_s / _RAD_S_PER_RPM


def pa_from_bar(pressure_bar: Quantity) -> Quantity:
    return pressure_bar * _PA_PER_BAR


def bar_from_pa(pressure_pa: Quantity) -> Quantity:
    return pressure_pa / _PA_PER_BAR


def k_from_degc(temperature_degc: Quantity) -> Quantity:
    """Return an absolute temperature [K]."""
    return temperature_degc + _ICE_POINT_K


def degc_from_k(temperature_k: Quantity) -> Quantity:
    return temperature_k - _ICE_POINT_K


def m_s_from_km_h(speed_km_h: Quantity) -> Quantity:
    return speed_km_h / _KM_H_PER_M_S


def km_h_from_m_s(speed_m_s: Quantity) -> Quantity:
    """Return a speed in kilometres per hour."""
    return speed_m_s * _KM_H_PER_M_S


_OF_PEOPLE: Final[Mapping[str, tuple[Callable[[float], float], str]]] = MappingProxyType(
    {
        "_pa": (bar_from_pa, "bar"),
        "_rise_k": (float, "K"),  # a difference
        "_k": (degc_from_k, "°C"),
        "_s_rad": (lambda slope_s_rad: slope_s_rad * rad_s_from_rpm(1000.0), "per 1000 rpm"),
        "_rad_s2": (rpm_from_rad_s, "rpm/s"),
        "_rad_s": (rpm_from_rad_s, "rpm"),
        "_rad": (lambda angle_rad: angle_rad / math.tau, "turns"),
        "_m_s3": (float, "m/s³"),
        "_m_s2": (float, "m/s²"),
        "_m_s": (km_h_from_m_s, "km/h"),
        "_m": (lambda length_m: length_m / 1000.0, "km"),
        "_nm": (float, "Nm"),
        "_j": (lambda energy_j: energy_j / 1000.0, "kJ"),
    }
)


def for_people(name: str, value: float) -> tuple[str, float, str]:
    """Return name, value and unit of a quantity as people read it; ``name`` ends in its SI unit."""
    for suffix, (factor, unit) in _OF_PEOPLE.items():
        if name.endswith(suffix):
            return name.removesuffix("_k" if suffix == "_rise_k" else suffix), factor(value), unit
    return name, value, ""


def reading_of(table: Mapping[str, object], name: str) -> tuple[str, float, float | None, str] | None:
    """Return name, value, standard deviation and unit of a number of a record as people read it.

    Its standard deviation is the record's ``std_NAME``; that has no reading of its own.
    """
    value, std = table.get(name), table.get(f"std_{name}")
    is_deviation = name.startswith("std_") and isinstance(table.get(name.removeprefix("std_")), float)
    if is_deviation or not isinstance(value, float):
        return None
    label, shown, unit = for_people(name, value)
    return label, shown, abs(for_people(name, value + std)[1] - shown) if isinstance(std, float) else None, unit
