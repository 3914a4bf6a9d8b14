"""Clutch torques, pack temperatures and viscosities along the smoothed motion."""

from dataclasses import dataclass

import numpy as np

from studies.full_estimator.inversion import heated_k
from studies.full_estimator.motion import Forcing, MotionLaw, State, diff_acceleration_rad_s2
from studies.full_estimator.signals import FullSignals
from studies.full_estimator.smoother import Motion
from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.pack import viscosities_pa_s
from diag_service.diagnosis.friction.paper.driveline import Driveline

REST_RAD_S = 0.3  # slip below this is a locked clutch's and heats nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchState:
    """What the exact torques and the smoothed motion say of one clutch; all (n,)."""

    torque_nm: FloatArray  # T_F
    slip_rad_s: FloatArray
    slip_std_rad_s: FloatArray
    viscosity: FloatArray  # of the oil in its film [Pa s]


def clutch_states(
    signals: FullSignals,
    forced: Forcing,
    motion: Motion,
    law: MotionLaw,
    calibration: Calibration,
    driveline: Driveline,
) -> tuple[ClutchState, ClutchState]:
    """Return both clutches: T_F from eqs. (2) and (3), the pack's heat from (T1)."""
    acceleration = diff_acceleration_rad_s2(motion.states, forced, law)
    oil = calibration.viscosity
    found = []
    for m, (shaft, clutch) in enumerate(zip(driveline.shafts, calibration.clutches, strict=True)):
        twist, ratio = forced.twist[m], forced.ratio[m]
        speed = ratio * motion.states[:, State.DIFF_SPEED] + twist.rate_rad_s
        rate = ratio * acceleration + twist.acceleration_rad_s2
        torque_nm = (
            signals.shaft_nm[m] + shaft.clutch_damping_nms_rad * speed + shaft.clutch_inertia_kg_m2 * rate
        ) * forced.is_coupled
        slip_rad_s = motion.slip_rad_s[m]
        power_w = np.abs(torque_nm * slip_rad_s) * (np.abs(slip_rad_s) > REST_RAD_S)
        thermal = clutch.thermal
        clutch_k = heated_k(power_w, signals.oil_k, signals.period_s, thermal.heat_capacity_j_k, thermal.convection_w_k)
        found.append(
            ClutchState(
                torque_nm=torque_nm,
                slip_rad_s=slip_rad_s,
                slip_std_rad_s=motion.slip_std_rad_s[m],
                viscosity=viscosities_pa_s(clutch_k, oil.a_pa_s, oil.b_k, oil.pole_k),
            )
        )
    return found[0], found[1]
