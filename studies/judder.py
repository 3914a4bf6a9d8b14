"""Whether a slipping clutch judders: how fast the driveline's swing grows, by load and slip, in aged and new fluid.

The plant is linearised about a steady slip of clutch 1 in 1st gear. A friction that falls with the slip feeds the
swing, the dampers of the driveline take from it. A swing that grows needs some periods at low slip before a clutch
that has stuck lets go again.

python -m studies.judder
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import contact_torque_nm, equilibrium_film_m, friction_law, kinetic_friction, viscosity_pa_s
from clutch_model.units import k_from_degc
from ecu_emulator.plant import DriveSettings, FrictionFactors, nominal_parameters
from ecu_emulator.plant import state as at
from ecu_emulator.plant.clutch import refresh_contact
from ecu_emulator.plant.course import as_record
from ecu_emulator.plant.driveline import ENGAGED
from ecu_emulator.plant.powertrain import drive_law
from ecu_emulator.plant.rates import evaluate

FloatArray = npt.NDArray[np.float64]

FLUIDS: Final = {"aged": FrictionFactors(mu_c1=0.85, mu_s1=1.15), "new": FrictionFactors()}
LOADS_NM: Final = (20.0, 30.0, 40.0, 60.0, 80.0, 120.0)
SLIPS_RAD_S: Final = (0.5, 1.0, 2.0, 4.0)
SPEED_M_S: Final = 4.0  # of the car towards the end of a launch
OIL_DEGC: Final = 90.0
BAND_HZ: Final = (2.0, 20.0)  # in which the input shaft swings against the car
# What swings: the gears turn with the differential; film, manifold and heat are slow.
SWINGING: Final = (
    *(at.W_E, at.W_H, at.W_L, at.W_L + 1, at.W_D, at.W_W, at.V),
    *(at.PHI_FW, at.PHI_SI, at.PHI_SI + 1, at.PHI_OS),
)
NUDGE: Final = 1.0e-6
FRICTION: Final = friction_law(nominal_calibration().clutches[0].friction)
LAW: Final = as_record(drive_law(nominal_calibration(), nominal_parameters(), DriveSettings()))


def slipping(load_nm: float, slip_rad_s: float, fluid: FrictionFactors) -> tuple[FloatArray, FloatArray]:
    """Return state and inputs of a car on clutch 1, which slips and carries a load."""
    plant, ratio = LAW.plant, float(LAW.overall_ratios[1])
    clutch, vehicle = plant.clutches.first, plant.vehicle
    y, u = np.zeros(at.STATE_COUNT), np.zeros(at.INPUT_COUNT)
    u[at.RATIO : at.RATIO + 2] = LAW.overall_ratios[1:3]
    u[at.DIRECTION : at.DIRECTION + 2] = 1.0
    u[at.MU_C], u[at.MU_S] = FRICTION.mu_c * fluid.mu_c1, FRICTION.mu_s * fluid.mu_s1
    u[at.VISCOSITY : at.VISCOSITY + 2] = viscosity_pa_s(
        k_from_degc(OIL_DEGC), plant.fluid.a_pa_s, plant.fluid.b_k, plant.fluid.pole_k
    )
    y[at.V], y[[at.W_D, at.W_W]] = SPEED_M_S, SPEED_M_S / vehicle.wheel_radius_m
    y[at.W_L] = ratio * y[at.W_D]
    y[at.W_L + 1] = LAW.overall_ratios[2] * y[at.W_D]
    y[[at.W_E, at.W_H]] = y[at.W_L] + slip_rad_s
    y[at.PHI_FW], y[at.PHI_SI] = (
        load_nm / plant.flywheel.stiffness_nm_rad,
        load_nm / plant.shafts.first.stiffness_nm_rad,
    )
    y[at.PHI_OS] = ratio * load_nm / plant.output.stiffness_nm_rad
    y[at.P_M] = 0.5 * plant.engine.ambient_pressure_pa
    friction = FRICTION._replace(mu_c=float(u[at.MU_C]), mu_s=float(u[at.MU_S]))
    mu = kinetic_friction(slip_rad_s, friction)
    contact_pa = load_nm / contact_torque_nm(1.0, mu, 1.0, clutch.film.contact_factor_m3)  # it is proportional to it
    y[at.FILM], y[at.FILM + 1] = equilibrium_film_m(contact_pa, clutch.film), plant.clutches.second.film.open_gap_m
    for index, one in enumerate((clutch, plant.clutches.second)):
        refresh_contact(y, index, one)
    return y, u


def growth_per_s(load_nm: float, slip_rad_s: float, fluid: FrictionFactors) -> tuple[float, float]:
    """Return growth rate [1/s], negative where it dies away, and frequency [Hz] of the swing."""
    y, u = slipping(load_nm, slip_rad_s, fluid)
    slopes = np.column_stack([(_rates(y, u, place, NUDGE) - _rates(y, u, place, -NUDGE)) for place in SWINGING])
    roots = np.linalg.eigvals(slopes / (2.0 * NUDGE))
    swings = [root for root in roots if BAND_HZ[0] < root.imag / (2.0 * math.pi) < BAND_HZ[1]]
    return max(
        ((float(root.real), float(root.imag / (2.0 * math.pi))) for root in swings), default=(math.nan, math.nan)
    )


def _rates(y: FloatArray, u: FloatArray, place: int, nudge: float) -> FloatArray:
    moved, out = y.copy(), np.zeros(at.OUTPUT_COUNT)
    moved[place] += nudge
    moved[at.W_G : at.W_G + 2] = u[at.RATIO : at.RATIO + 2] * moved[at.W_D]
    modes = np.zeros(at.MODE_COUNT, np.int64)
    modes[at.LINK : at.LINK + 2] = ENGAGED
    evaluate(moved, u, modes, out, LAW.plant)
    return out[list(SWINGING)]


def main() -> None:
    """Print one table per fluid."""
    console = Console(markup=False, width=110)
    for name, fluid in FLUIDS.items():
        table = Table(
            "load",
            *(f"slip {slip:g} rad/s" for slip in SLIPS_RAD_S),
            title=f"Growth of the swing, {name} fluid (none: too damped to swing)",
        )
        for load_nm in LOADS_NM:
            cells = [growth_per_s(load_nm, slip, fluid) for slip in SLIPS_RAD_S]
            table.add_row(
                f"{load_nm:g} Nm",
                *(
                    "none" if math.isnan(growth) else f"{growth:+.1f}/s, {frequency:.1f} Hz"
                    for growth, frequency in cells
                ),
            )
        console.print(table)


if __name__ == "__main__":
    main()
