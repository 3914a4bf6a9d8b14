"""The method of SAE 2015-01-1146: friction from clutch torques, gated samples and least squares.

It states no uncertainty, so nothing here leads to a verdict; it is the yardstick of the project's own estimator.
"""

from diag_service.diagnosis.friction.paper.collection import PaperCollection, PaperShift, PooledClutch
from diag_service.diagnosis.friction.paper.differentiate import (
    SteadyKalman,
    central_difference,
    matched_filter,
    quiet_filter,
    steady_kalman,
    steady_kalman_gain,
)
from diag_service.diagnosis.friction.paper.driveline import Driveline, nominal_driveline
from diag_service.diagnosis.friction.paper.film_table import FilmTable, static_table, trajectory_table
from diag_service.diagnosis.friction.paper.fit import Gate, Gates, PaperEstimate, fit
from diag_service.diagnosis.friction.paper.method import Analysis, Differentiators, analyse
from diag_service.diagnosis.friction.paper.paper_signals import PaperSignals

__all__ = [
    "Analysis",
    "Differentiators",
    "Driveline",
    "FilmTable",
    "Gate",
    "Gates",
    "PaperCollection",
    "PaperEstimate",
    "PaperShift",
    "PaperSignals",
    "PooledClutch",
    "SteadyKalman",
    "analyse",
    "central_difference",
    "fit",
    "matched_filter",
    "nominal_driveline",
    "quiet_filter",
    "static_table",
    "steady_kalman",
    "steady_kalman_gain",
    "trajectory_table",
]
