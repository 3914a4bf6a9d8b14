"""Shared physics of the wet dual clutch: laws as pure SI functions and the calibrations that feed them.

The laws live in a module of their own (`pack`), so that a program which only reads a calibration does not load the
compiler.
"""

from clutch_model.calibration import Calibration, ClutchCalibration, nominal_calibration, read_calibration
from clutch_model.errors import CalibrationError, ClutchModelError, DomainError

__all__ = [
    "Calibration",
    "CalibrationError",
    "ClutchCalibration",
    "ClutchModelError",
    "DomainError",
    "nominal_calibration",
    "read_calibration",
]
