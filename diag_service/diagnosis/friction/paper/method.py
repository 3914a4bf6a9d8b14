"""The paper's method from signals to friction data: the only file that knows the order of its steps."""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from diag_service.diagnosis.friction.paper.clutch_torques import Speeds, clutch_torques_nm
from diag_service.diagnosis.friction.paper.differentiate import Differentiator, Rated, central_difference
from diag_service.diagnosis.friction.paper.driveline import Driveline
from diag_service.diagnosis.friction.paper.film_table import FilmTable
from diag_service.diagnosis.friction.paper.friction_data import (
    ClutchTorques,
    FrictionData,
    friction_data,
    viscous_torques_nm,
)
from diag_service.diagnosis.friction.paper.paper_signals import PaperSignals


@dataclass(frozen=True, slots=True, kw_only=True)
class Differentiators:
    """How speeds and pressures are differentiated, and with noise filtered."""

    speed: Differentiator
    pressure: Differentiator


NOISELESS = Differentiators(speed=central_difference, pressure=central_difference)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchAnalysis:
    """One clutch on its way through the method; all (n,)."""

    pressure: Rated
    film_m: FloatArray
    torques: ClutchTorques
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
    friction_nm = clutch_torques_nm(
        speeds, signals.flywheel_nm, signals.shaft_nm, calibration.input_side, driveline.shafts
    )
    clutches = []
    for m, (believed, table) in enumerate(zip(calibration.clutches, tables, strict=True)):
        pressure = differentiators.pressure(signals.pressure_pa[m], signals.period_s)
        slip_rad_s = speeds.slip_rad_s(m + 1)
        film_m = np.maximum(table.film_at(pressure.value), believed.film.min_film_m)
        viscous_nm = viscous_torques_nm(slip_rad_s, film_m, signals.oil_k, believed, calibration.viscosity)
        torques = ClutchTorques(friction_nm=friction_nm[m], viscous_nm=viscous_nm)
        data = friction_data(torques, slip_rad_s, film_m, pressure.rate, signals.is_shifting, believed)
        clutches.append(ClutchAnalysis(pressure=pressure, film_m=film_m, torques=torques, data=data))
    return Analysis(speeds=speeds, clutches=(clutches[0], clutches[1]))
