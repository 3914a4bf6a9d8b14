"""How much of a vehicle is known of what driving can tell of it: the service calibrates itself while it serves."""

import math
from typing import Final

import numpy as np

from clutch_model.calibration import Calibration
from diag_service.diagnosis.friction.parameters import FRICTION_COUNT, STATE_COUNT, Considered, State, type_std
from diag_service.diagnosis.friction.posterior import Posterior

_LEARNT: Final = np.array((
    State.TORQUE_OFFSET,
    State.TOUCH1,
    State.TOUCH2,
    State.ZERO1,
    State.ZERO2,
    STATE_COUNT + Considered.VISCOSITY,
    STATE_COUNT + Considered.TORQUE_LATENCY,
    STATE_COUNT + Considered.PRESSURE_LATENCY,
))  # fmt: skip
"""What ordinary shifts tell; gain of torque and piston areas they do not."""
_AMONG_NUISANCES: Final = (_LEARNT - FRICTION_COUNT).tolist()


def calibration_ratio(state: Posterior, calibration: Calibration) -> float:
    """Return by how much the deviations of sensors, oil and latencies have shrunk from those of the type, 0 to 1."""
    variances, stds = state.known.covariance[_LEARNT, _LEARNT].tolist(), type_std(calibration)
    of_type = [stds[row] for row in _AMONG_NUISANCES]
    left = [math.sqrt(now) / std if std else 0.0 for now, std in zip(variances, of_type, strict=True)]
    return sum(1.0 - min(one, 1.0) for one in left) / len(left)
