"""The picture of the emulated torque converter: its characteristic beside a public one, and a shudder.

python -m studies.converter_picture    # drives 40 s, writes docs/converter.svg
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from studies.drawing import CLUTCH_COLOUR, INK, MUTED, as_svg, drawing_style
from canlog.arrays import FloatArray
from clutch_model.calibration import shipped_calibration
from clutch_model.units import rpm_from_rad_s
from ecu_emulator.drive.build import FLUID_FACTORS
from ecu_emulator.driving.trace import SpeedTrace
from ecu_emulator.driving.trip import Car, DriveConditions, Trip
from ecu_emulator.plant.converter import converter_law, impeller_torque_nm, torque_ratio
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.scenario import FluidCondition

# MathWorks, "Modeling an Automatic Transmission Controller": speed ratio, K factor [rpm per root lb ft], torque ratio.
PUBLIC: Final = np.array([
    (0.0, 137.47, 2.232), (0.1, 137.07, 2.075), (0.2, 135.86, 1.975), (0.3, 135.66, 1.846), (0.4, 137.57, 1.720),
    (0.5, 140.37, 1.564), (0.6, 145.27, 1.409), (0.7, 152.87, 1.254), (0.8, 162.98, 1.096), (0.85, 172.78, 1.012),
    (0.9, 197.69, 0.999), (0.92, 215.90, 1.001), (0.94, 244.52, 1.002),
])  # fmt: skip
PATH: Final = Path(__file__).parents[1] / "docs" / "converter.svg"
SHOWN_S: Final = (38.0, 39.0)


def characteristic() -> FloatArray:
    """Return rows of speed ratio, torque of the impeller over that at stall, torque ratio; beyond 1 the overrun."""
    law = converter_law(shipped_calibration("lockup").converter)
    places = np.linspace(0.0, 1.15, 116)
    stall_nm = impeller_torque_nm(1.0, 0.0, law)
    return np.array(
        [(one, impeller_torque_nm(1.0, one, law) / stall_nm, torque_ratio(1.0, one, law)) for one in places]
    )


def public_capacity() -> FloatArray:
    """Return the public converter's torque of the impeller over that at stall: it goes with the K factor's square."""
    capacity: FloatArray = (PUBLIC[0, 1] / PUBLIC[:, 1]) ** 2
    return capacity


def slipping(fluid: FluidCondition) -> FloatArray:
    """Return rows of a car that gains speed slowly in a high gear."""
    calibration, (by_c, by_s) = shipped_calibration("lockup"), FLUID_FACTORS[fluid]
    clutch = calibration.clutches[0]
    friction = replace(clutch.friction, mu_c=by_c * clutch.friction.mu_c, mu_s=by_s * clutch.friction.mu_s)
    truth = replace(calibration, clutches=(replace(clutch, friction=friction),) * 2)
    points_s, speeds_m_s = np.array([0.0, 2.0, 14.0, 30.0, 44.0]), np.array([0.0, 0.0, 16.0, 22.0, 26.0])
    road = SpeedTrace(name="gaining speed", t_s=points_s, speed_m_s=speeds_m_s, grade_ratio=np.zeros(5))
    car = Car(truth=truth, parameters=nominal_parameters("lockup"))
    return Trip(car, road, DriveConditions(whim_ratio=0.0), np.random.default_rng(1)).advance(SHOWN_S[1])


def draw() -> str:
    """Return the picture as SVG."""
    own = characteristic()
    with drawing_style():
        figure = Figure(figsize=(8.0, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.plot(own[:, 0], own[:, 1], color=CLUTCH_COLOUR[2], lw=2.0, label="impeller torque over stall")
        left.plot(own[:, 0], own[:, 2], color=CLUTCH_COLOUR[1], lw=2.0, label="torque ratio")
        is_forward = own[:, 0] <= 1.0
        efficiency = own[is_forward, 0] * own[is_forward, 2]
        left.plot(own[is_forward, 0], efficiency, color=MUTED, lw=1.5, label="efficiency")
        left.plot(PUBLIC[:, 0], public_capacity(), "o", color=INK, ms=3.5, label="a public converter")
        left.plot(PUBLIC[:, 0], PUBLIC[:, 2], "o", color=INK, ms=3.5)
        left.set_ylim(-0.6, 2.4)
        left.set_xlabel("turbine over engine speed")
        left.legend(fontsize=8)
        for fluid, colour, label in (
            (FluidCondition.IDEAL, MUTED, "new"),
            (FluidCondition.CASE_2, CLUTCH_COLOUR[1], "aged"),
        ):
            rows = slipping(fluid)
            rows = rows[rows[:, Col.T_S] >= SHOWN_S[0]]
            slip_rpm = rpm_from_rad_s(rows[:, Col.HUB_SPEED] - rows[:, Col.INPUT1_SPEED])
            right.plot(rows[:, Col.T_S], slip_rpm, color=colour, lw=1.5, label=f"{label} fluid")
        right.set_xlabel("time [s]")
        right.set_ylabel("slip of the lock-up clutch [rpm]")
        right.legend(fontsize=8)
        return as_svg(figure)


def main(argv: Sequence[str] | None = None) -> int:
    """Make the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=PATH)
    arguments = parser.parse_args(argv)
    arguments.output.write_text(draw(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
