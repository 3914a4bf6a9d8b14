"""What a prognosis must beat: a fixed interval, the lives of a fleet, a straight line through the results."""

from typing import Final

import numpy as np

from benchmarks.prognosis.lives import REFERENCE
from benchmarks.prognosis.scores import PROBABILITIES
from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis import History

INTERVAL_KM: Final = 60_000.0  # what makers of wet dual-clutch transmissions commonly ask for
FARTHEST_KM: Final = 300_000.0
LINE_DRAWS: Final = 400


def fixed_interval(age_km: float) -> FloatArray:
    """Return what remains of the maker's interval, a number without doubt, as quantiles [km]."""
    return np.full(len(PROBABILITIES), max(INTERVAL_KM - age_km, 0.0))


def fleet(age_km: float, lives_km: FloatArray) -> FloatArray:
    """Return what remained to those of a fleet whose fluid lasted longer than this one already has [km]."""
    left_km = lives_km[lives_km > age_km] - age_km
    return np.quantile(left_km, PROBABILITIES) if len(left_km) else np.zeros(len(PROBABILITIES))


def straight_line(history: History, rng: np.random.Generator) -> FloatArray:
    """Return where least squares through the margins of the noted fluid reach zero, errors of the line drawn [km]."""
    own = history.fluid_number == history.fluid_number[-1]
    distance_km = (history.odometer_m[own] - history.odometer_m[-1]) / 1000.0
    margin = (history.mu_c[own] - history.mu_s[own]) / (REFERENCE.mu_c - REFERENCE.mu_s)
    if len(margin) < 4:
        return np.full(len(PROBABILITIES), FARTHEST_KM)
    design = np.column_stack((np.ones_like(distance_km), distance_km / 1.0e4))
    normal = design.T @ design
    line = np.linalg.solve(normal, design.T @ margin)
    variance = float(np.mean((margin - design @ line) ** 2)) * len(margin) / (len(margin) - 2)
    now, rate = rng.multivariate_normal(line, variance * np.linalg.inv(normal), LINE_DRAWS).T
    falls = rate < 0.0
    left_km = np.where(falls, 1.0e4 * now / np.where(falls, -rate, 1.0), FARTHEST_KM)
    return np.quantile(np.clip(left_km, 0.0, FARTHEST_KM), PROBABILITIES)
