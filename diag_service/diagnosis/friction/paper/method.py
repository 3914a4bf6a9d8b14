"""The paper's method from signals to friction data: the only file that knows the order of its steps."""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import Calibration, InputSide, both_clutches
from diag_service.diagnosis.friction.paper.differentiate import Differentiator, Rated
from diag_service.diagnosis.friction.paper.driveline import Driveline, Shaft
from diag_service.diagnosis.friction.paper.friction_data import (
    FilmTable,
    FrictionData,
    friction_data,
    viscous_torques_nm,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSignals:
    """Signals of a drive or of a shift at even intervals; both clutches in one array, clutch 1 first."""

    period_s: float
    hub_rad_s: FloatArray  # (n,) w_H
    input_rad_s: FloatArray  # (2, n) w_L
    pressure_pa: FloatArray  # (2, n) P_K
    flywheel_nm: FloatArray  # (n,) T_FW
    shaft_nm: FloatArray  # (2, n) T_si
    oil_k: FloatArray  # (n,) sump
    is_shifting: BoolArray  # (n,) a shift is under way and its clutch has not stuck yet


@dataclass(frozen=True, slots=True, kw_only=True)
class Differentiators:
    """How speeds and pressures are differentiated, and with noise filtered."""

    speed: Differentiator
    pressure: Differentiator


@dataclass(frozen=True, slots=True, kw_only=True)
class Speeds:
    """The speeds of eqs. (1) to (3) with their accelerations."""

    hub: Rated
    inputs: tuple[Rated, Rated]

    def slip_rad_s(self, clutch: int) -> FloatArray:
        """Return the slip of clutch 1 or 2 [rad/s], shape (n,): hub minus gearbox side."""
        slip_rad_s: FloatArray = self.hub.value - self.inputs[clutch - 1].value
        return slip_rad_s


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchAnalysis:
    """One clutch on its way through the method; all (n,)."""

    pressure: Rated
    film_m: FloatArray
    friction_nm: FloatArray  # T_F
    viscous_nm: FloatArray  # T_V
    data: FrictionData


@dataclass(frozen=True, slots=True, kw_only=True)
class Analysis:
    """Both clutches, and the speeds they were seen with."""

    speeds: Speeds
    clutches: tuple[ClutchAnalysis, ClutchAnalysis]


def analyse(
    signals: PaperSignals,
    differentiators: Differentiators,
    tables: tuple[FilmTable, FilmTable],
    calibration: Calibration,
    driveline: Driveline,
) -> Analysis:
    """Return the friction data of both clutches: eqs. (10) to (16), then (9), then (17)."""
    hub, first, second = (
        differentiators.speed(one, signals.period_s) for one in (signals.hub_rad_s, *signals.input_rad_s)
    )
    speeds = Speeds(hub=hub, inputs=(first, second))
    side = calibration.input_side
    friction_nm = clutch_torques_nm(speeds, signals.flywheel_nm, signals.shaft_nm, side, driveline.shafts)
    clutches = []
    for m, (clutch, table) in enumerate(zip(calibration.clutches, tables, strict=True)):
        pressure = differentiators.pressure(signals.pressure_pa[m], signals.period_s)
        slip_rad_s = speeds.slip_rad_s(m + 1)
        film_m = np.maximum(table.film_at(pressure.value), clutch.film.min_film_m)
        viscous_nm = viscous_torques_nm(slip_rad_s, film_m, signals.oil_k, clutch, calibration.viscosity)
        contact_nm = friction_nm[m] - viscous_nm
        data = friction_data(contact_nm, slip_rad_s, film_m, pressure.rate, signals.is_shifting, clutch)
        clutches.append(
            ClutchAnalysis(
                pressure=pressure, film_m=film_m, friction_nm=friction_nm[m], viscous_nm=viscous_nm, data=data
            )
        )
    return Analysis(speeds=speeds, clutches=both_clutches(clutches))


def clutch_torques_nm(
    speeds: Speeds, flywheel_nm: FloatArray, shaft_nm: FloatArray, side: InputSide, shafts: tuple[Shaft, Shaft]
) -> FloatArray:
    """Return the friction torques T_F of clutch 1 and 2 [N m], shape (2, n).

    Eqs. (1) to (3) are three equations for two unknowns; this is their least squares solution; docs/model.md eq. (9).

    Parameters
    ----------
    flywheel_nm : (n,) array
        Torque T_FW of the flywheel on the hub.
    shaft_nm : (2, n) array
        Torques T_si that the input shafts carry off.
    """
    hub_nm = flywheel_nm - side.hub_damping_nms_rad * speeds.hub.value - side.hub_inertia_kg_m2 * speeds.hub.rate
    first_nm, second_nm = (
        shaft.clutch_inertia_kg_m2 * speed.rate + carried_nm + shaft.clutch_damping_nms_rad * speed.value
        for shaft, speed, carried_nm in zip(shafts, speeds.inputs, shaft_nm, strict=True)
    )
    return np.stack((hub_nm + 2.0 * first_nm - second_nm, hub_nm - first_nm + 2.0 * second_nm)) / 3.0
