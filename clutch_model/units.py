"""The only conversion factors of the project: what people and wires use, to and from SI. Floats or arrays."""

import math
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Quantity = TypeVar("Quantity", float, npt.NDArray[np.float64])

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
