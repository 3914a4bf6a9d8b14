"""The score of prognoses beside scoringrules: the same forecasts, the largest relative difference.

python -m tests.tools.crps
"""

import sys

import numpy as np
import scoringrules

from benchmarks.prognosis.scores import crps

FORECASTS = 10_000
ALLOWED_RATIO = 1e-9


def main() -> int:
    """Compare, print, and return 1 where they differ by more than rounding."""
    rng = np.random.default_rng(4)
    quantiles = np.sort(rng.lognormal(3.0, 0.5, (FORECASTS, 99)), axis=1)
    truth = rng.lognormal(3.0, 0.7, FORECASTS)
    theirs = scoringrules.crps_ensemble(truth, quantiles, estimator="nrg", backend="numpy")
    apart = float(np.max(np.abs(crps(quantiles, truth) / theirs - 1.0)))
    sys.stdout.write(f"CRPS of {FORECASTS:,} forecasts: at most {apart:.1e} apart from scoringrules\n")
    return int(apart > ALLOWED_RATIO)


if __name__ == "__main__":
    sys.exit(main())
