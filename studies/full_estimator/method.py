"""The full-information estimator from signals to friction: the only file that knows the order of its steps."""

from dataclasses import dataclass

import numpy as np

from studies.full_estimator.fit import FullEstimate, fit
from studies.full_estimator.locks import locked_clutches
from studies.full_estimator.motion import forcing, motion_law
from studies.full_estimator.signals import BoolArray, FullSignals
from studies.full_estimator.smoother import Motion, smooth
from studies.full_estimator.torques import ClutchState, clutch_states
from studies.full_estimator.vehicle import Vehicle
from studies.full_estimator.windows import Window, windows
from clutch_model.calibration import Calibration
from diag_service.diagnosis.friction.paper.driveline import Driveline

PASS_COUNT = 3  # without locks, with those found, with those found again


@dataclass(frozen=True, slots=True, kw_only=True)
class FullAnalysis:
    """What the estimator makes of a drive, friction last."""

    motion: Motion
    is_locked: BoolArray  # (2, n) as the smoother was told
    clutches: tuple[ClutchState, ClutchState]
    windows: tuple[list[Window], list[Window]]
    estimates: tuple[FullEstimate | None, FullEstimate | None]


def estimate_drive(
    signals: FullSignals, calibration: Calibration, driveline: Driveline, vehicle: Vehicle
) -> FullAnalysis:
    """Return the friction of both clutches from the full information about a drive."""
    law = motion_law(calibration.input_side, driveline, vehicle)
    forced = forcing(signals, driveline, vehicle)
    is_locked = np.zeros(signals.input_rad_s.shape, dtype=np.bool_)
    motion = smooth(signals, forced, law, is_locked)
    for _ in range(PASS_COUNT - 1):
        found = clutch_states(signals, forced, motion, law, calibration, driveline)
        is_locked = locked_clutches(signals, found, calibration.clutches)
        motion = smooth(signals, forced, law, is_locked, motion.states)
    clutches = clutch_states(signals, forced, motion, law, calibration, driveline)
    first, second = (
        windows(signals, state, forced.is_coupled, m + 1, calibration.clutches[m]) for m, state in enumerate(clutches)
    )
    return FullAnalysis(
        motion=motion,
        is_locked=is_locked,
        clutches=clutches,
        windows=(first, second),
        estimates=(fit(first, calibration.clutches[0]), fit(second, calibration.clutches[1])),
    )
