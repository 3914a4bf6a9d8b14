"""Friction estimation: a shift event in, an estimate with its uncertainty and the new running state out."""

from diag_service.diagnosis.friction.estimator import ALGORITHM_VERSION, Estimator
from diag_service.diagnosis.friction.filter_state import FilterState

__all__ = ["ALGORITHM_VERSION", "Estimator", "FilterState"]
