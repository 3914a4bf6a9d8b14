"""Lateness statistics against numpy's on the same numbers."""

import numpy as np
import pytest

from ecu_emulator.bus.sender import BIN_S, SendLateness


def test_statistics_match_numpy() -> None:
    rng = np.random.default_rng(3)
    due_s = np.sort(rng.uniform(0.0, 60.0, 5_000))
    late_s = rng.exponential(200e-6, 5_000) + 3e-6 * due_s
    punctuality = SendLateness(overrun_s=1e-3)
    for due, late in zip(due_s, late_s, strict=True):
        punctuality.add(float(due), float(late))
    assert punctuality.mean_s == pytest.approx(late_s.mean(), rel=1e-9)
    assert punctuality.max_s == late_s.max()
    assert punctuality.overruns == np.count_nonzero(late_s > 1e-3)
    assert punctuality.drift_ppm == pytest.approx(1e6 * np.polyfit(due_s, late_s, 1)[0], rel=1e-6)
    for fraction in (0.5, 0.95, 0.99):
        exact = np.quantile(late_s, fraction, method="inverted_cdf")
        assert exact <= punctuality.quantile_s(fraction) <= exact + BIN_S
