"""Friction estimation: a shift event in, an estimate with its uncertainty and the new running state out."""

from diag_service.diagnosis.friction.belief import Belief
from diag_service.diagnosis.friction.estimator import ALGORITHM_VERSION, Estimator

__all__ = ["ALGORITHM_VERSION", "Belief", "Estimator"]
