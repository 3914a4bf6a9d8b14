"""Full information: friction from everything that the paper's sensors say about a whole drive, at the physical limit.

A smoother finds the motion that explains every reading, the exact torques and the locked clutches together. The clutch
torques follow, and from them, backwards through friction and film, the pressure that the sensor must have read.
"""

from studies.full_estimator.fit import FullEstimate
from studies.full_estimator.method import FullAnalysis, estimate_drive
from studies.full_estimator.signals import FullSignals
from studies.full_estimator.vehicle import Vehicle, nominal_vehicle

__all__ = ["FullAnalysis", "FullEstimate", "FullSignals", "Vehicle", "estimate_drive", "nominal_vehicle"]
