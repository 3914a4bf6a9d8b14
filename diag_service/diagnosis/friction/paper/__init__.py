"""The method of SAE 2015-01-1146: friction from clutch torques, gated samples and least squares.

It states no uncertainty, so nothing here leads to a verdict; it is the yardstick of the project's own estimator.
"""

from diag_service.diagnosis.friction.paper.driveline import nominal_driveline
from diag_service.diagnosis.friction.paper.method import PaperCollection, PaperEstimate, PaperShift, PooledClutch

__all__ = ["PaperCollection", "PaperEstimate", "PaperShift", "PooledClutch", "nominal_driveline"]
