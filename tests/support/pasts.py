"""Pasts of a clutch as columns: margins and levels along straight lines, with noise, temperature and fills."""

from collections.abc import Sequence

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_results.prognosis import History

REFERENCE = nominal_calibration().clutches[0].friction
NEW_MARGIN = REFERENCE.mu_c - REFERENCE.mu_s


def past(
    margin: FloatArray,
    *,
    level: FloatArray | None = None,
    step_m: float = 2.0e5,
    noise_ratio: float = 0.01,
    warmth_k: FloatArray | None = None,
    fills: Sequence[int] = (),
    seed: int = 1,
) -> History:
    """Return results whose truth is a margin and a level, a row each, both over those of new fluid.

    ``noise_ratio`` is that of mu_C and mu_S and stated so; ``fills`` are rows at which a noted fluid begins.
    """
    count = len(margin)
    rng = np.random.default_rng(seed)
    mu_c = REFERENCE.mu_c * (np.ones(count) if level is None else level)
    mu_s = mu_c - NEW_MARGIN * margin
    noise = noise_ratio * rng.standard_normal((2, count))
    return History(
        end_s=np.arange(count, dtype=np.float64) * 3600.0,
        odometer_m=step_m * np.arange(count, dtype=np.float64),
        mu_c=mu_c * (1.0 + noise[0]),
        mu_s=mu_s * (1.0 + noise[1]),
        random_std_mu_c=noise_ratio * mu_c,
        random_std_mu_s=noise_ratio * mu_s,
        random_correlation=np.zeros(count),
        common_std_mu_c=0.03 * mu_c,
        common_std_mu_s=0.03 * mu_s,
        common_correlation=np.full(count, 0.999),
        sump_temperature_k=353.15 + (np.zeros(count) if warmth_k is None else warmth_k),
        slip_energy_j=np.full(count, 8.0e3),
        fluid_number=np.searchsorted(np.array(fills, np.int64), np.arange(count), side="right").astype(np.int64),
        new_fluids=tuple(range(len(fills) + 1)),
    )


def ageing(count: int, *, until: float = 0.4) -> FloatArray:
    """Return a margin that falls evenly from new."""
    return np.linspace(1.0, until, count)
