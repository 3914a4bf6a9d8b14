"""Friction torques of both clutches from the bodies they accelerate; docs/model.md eq. (9)."""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import InputSide
from diag_service.diagnosis.friction.paper.differentiate import Rated
from diag_service.diagnosis.friction.paper.driveline import Shaft


@dataclass(frozen=True, slots=True, kw_only=True)
class Speeds:
    """The speeds of eqs. (1) to (3) with their accelerations."""

    hub: Rated
    inputs: tuple[Rated, Rated]

    def slip_rad_s(self, clutch: int) -> FloatArray:
        """Return the slip of clutch 1 or 2 [rad/s], shape (n,): hub minus gearbox side."""
        slip_rad_s: FloatArray = self.hub.value - self.inputs[clutch - 1].value
        return slip_rad_s


def clutch_torques_nm(
    speeds: Speeds, flywheel_nm: FloatArray, shaft_nm: FloatArray, side: InputSide, shafts: tuple[Shaft, Shaft]
) -> FloatArray:
    """Return the friction torques T_F of clutch 1 and 2 [N m], shape (2, n).

    Eqs. (1) to (3) are three equations for two unknowns; this is their least squares solution.

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
