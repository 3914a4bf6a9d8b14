"""How much of a vehicle is known of what driving can tell of it: the service calibrates itself while it serves."""

from typing import Final

import numpy as np

from clutch_model.calibration import Calibration
from diag_service.diagnosis.friction.parameters import FRICTION_COUNT, STATE_COUNT, Considered, State, type_std
from diag_service.diagnosis.friction.posterior import Posterior

_LEARNT: Final = (
    State.TORQUE_OFFSET,
    State.TOUCH1,
    State.TOUCH2,
    State.ZERO1,
    State.ZERO2,
    STATE_COUNT + Considered.VISCOSITY,
    STATE_COUNT + Considered.TORQUE_LATENCY,
    STATE_COUNT + Considered.PRESSURE_LATENCY,
)
"""What ordinary shifts tell; gain of torque and piston areas they do not."""


def calibration_ratio(state: Posterior, calibration: Calibration) -> float:
    """Return by how much the deviations of sensors, oil and latencies have shrunk from those of the type, 0 to 1."""
    rows = list(_LEARNT)
    ratio = state.known.std()[rows] / np.array(type_std(calibration))[[row - FRICTION_COUNT for row in rows]]
    return float(np.mean(1.0 - np.minimum(ratio, 1.0)))
