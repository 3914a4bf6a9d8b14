"""Solenoid, orifice and piston cavity of one clutch, docs/model.md section "Hydraulics"."""

import math
from typing import NamedTuple

from canlog.jit import part
from clutch_model.calibration import ClutchCalibration

_FADE_RATIO = 0.02  # the first share of the volume over which an empty cavity loses its pressure


class HydraulicsParameters(NamedTuple):
    """Numbers of the valve body, the same for both clutches."""

    line_pressure_pa: float  # P_line
    solenoid_lag_s: float  # tau_sol
    pack_compliance_m3_pa: float  # C_pack
    orifice_m3_s_sqrt_pa: float  # k_or
    laminar_pressure_pa: float  # dP_lam
    supply_ratio: float = 1.0  # of the line pressure that the pump reaches; the control does not know of less


class CavityLaw(NamedTuple):
    """Numbers of one piston and its cavity."""

    area_m2: float  # A_K
    preload_n: float  # F_pre
    spring_rate_n_m: float  # K_K
    full_volume_m3: float  # V_full
    touch_pressure_pa: float  # F_s / A_K


def cavity_law(clutch: ClutchCalibration) -> CavityLaw:
    """Return the kernel form of one piston."""
    area_m2 = float(clutch.geometry.piston_area_m2)
    return CavityLaw(
        area_m2=area_m2,
        preload_n=float(clutch.piston.spring_preload_n),
        spring_rate_n_m=float(clutch.piston.spring_rate_n_m),
        full_volume_m3=area_m2 * clutch.piston.fill_stroke_m,
        touch_pressure_pa=float(clutch.touch_pressure_pa),
    )


@part
def cavity_pressure_pa(volume_m3: float, cavity: CavityLaw, valve: HydraulicsParameters) -> float:
    """Return the piston pressure P_K [Pa] of a cavity that holds ``volume_m3`` of oil."""
    excess_m3 = volume_m3 - cavity.full_volume_m3
    if excess_m3 >= 0.0:
        return cavity.touch_pressure_pa + excess_m3 / valve.pack_compliance_m3_pa
    spring_n = cavity.preload_n + cavity.spring_rate_n_m * volume_m3 / cavity.area_m2
    fade = min(1.0, volume_m3 / (_FADE_RATIO * cavity.full_volume_m3))
    return fade * spring_n / cavity.area_m2


@part
def closed_volume_m3(piston_pa: float, cavity: CavityLaw, valve: HydraulicsParameters) -> float:
    """Return the oil volume [m^3] of a closed pack at a pressure above its touch point."""
    return cavity.full_volume_m3 + (piston_pa - cavity.touch_pressure_pa) * valve.pack_compliance_m3_pa


@part
def orifice_flow_m3_s(valve_pa: float, piston_pa: float, valve: HydraulicsParameters) -> float:
    """Return the flow into the cavity [m^3/s], laminar near zero pressure difference."""
    drop_pa = valve_pa - piston_pa
    return valve.orifice_m3_s_sqrt_pa * drop_pa / math.sqrt(abs(drop_pa) + valve.laminar_pressure_pa)
