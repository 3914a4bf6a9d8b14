"""Friction estimation: a shift event in, an estimate with its uncertainty and the new running state out."""

from diag_service.diagnosis.friction.estimator import ALGORITHM_VERSION, Estimator
from diag_service.diagnosis.friction.posterior import Posterior

__all__ = ["ALGORITHM_VERSION", "Estimator", "Posterior"]
