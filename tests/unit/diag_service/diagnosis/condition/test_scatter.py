"""Shift-to-shift scatter: what comes out is what went in, outliers or not."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.condition.verdict import Scatter
from diag_service.diagnosis.records import FrictionEstimate
from tests.support.builders import friction_estimate

RUNNING = replace(friction_estimate(), random_std_mu_c=0.0, random_std_mu_s=0.0)
STD = np.array([0.002, 0.005])


def shift(distances: np.ndarray) -> FrictionEstimate:
    return replace(RUNNING, mu_c=RUNNING.mu_c + distances[0], mu_s=RUNNING.mu_s + distances[1], random_std_mu_c=0.001)


def followed(distances: np.ndarray, running: FrictionEstimate = RUNNING) -> Scatter:
    scatter = Scatter.begun(replace(shift(distances[0]), random_std_mu_s=0.003))
    for one in distances:
        scatter = scatter.with_shift(replace(shift(one), random_std_mu_s=0.003), running)
    return scatter


def test_it_is_the_deviation_of_the_shifts() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(60):
        reported = followed(rng.normal(size=(60, 2)) * STD).reported
        assert reported is not None
        found.append((reported.std_mu_c, reported.std_mu_s))
    assert np.mean(found, axis=0) == pytest.approx(STD, rel=0.1)
    assert np.all(np.std(found, axis=0) < 0.2 * STD)
