"""Evidence and earlier knowledge put together, against least squares done in one go."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.evidence import PARAMETER_COUNT, Evidence, Knowledge, Measurement, fuse

SCALES = 10.0 ** np.random.default_rng(0).uniform(-4.0, 4.0, PARAMETER_COUNT)  # coefficients, pascals, seconds


def knowledge(rng: np.random.Generator) -> Knowledge:
    root = rng.normal(size=(PARAMETER_COUNT, PARAMETER_COUNT)) / np.sqrt(PARAMETER_COUNT)
    spread = (root @ root.T + np.eye(PARAMETER_COUNT)) * np.outer(SCALES, SCALES)
    return Knowledge(mean=rng.normal(size=PARAMETER_COUNT) * SCALES, covariance=spread)


def measurement(rng: np.random.Generator, truth: FloatArray, at: FloatArray, count: int = 24) -> Measurement:
    slope = rng.normal(size=(count, PARAMETER_COUNT)) / SCALES
    root = 0.2 * rng.normal(size=(count, count)) / np.sqrt(count)
    noise = root @ root.T + 0.01 * np.eye(count)
    drawn = np.linalg.cholesky(noise) @ rng.normal(size=count)
    return Measurement(residual=slope @ (truth - at) + drawn, slope=slope, noise=noise)


@pytest.mark.parametrize("seed", range(5))
def test_fusing_is_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = knowledge(rng)
    truth = known.mean + np.linalg.cholesky(known.covariance) @ rng.normal(size=PARAMETER_COUNT)
    at = [known.mean, truth, known.mean + SCALES]
    seen = [measurement(rng, truth, one) for one in at]
    total = Evidence.none()
    for one, where in zip(seen, at, strict=True):
        total = total.plus(Evidence.of([one], where))
    fused = fuse(known, total)

    rows = [np.linalg.cholesky(np.linalg.inv(known.covariance / np.outer(SCALES, SCALES))).T / SCALES]
    sides = [rows[0] @ known.mean]
    for one, where in zip(seen, at, strict=True):
        white = np.linalg.inv(np.linalg.cholesky(one.noise))
        rows.append(white @ one.slope)
        sides.append(white @ (one.residual + one.slope @ where))
    design, side = np.vstack(rows) * SCALES, np.concatenate(sides)
    solved, rest, *_ = np.linalg.lstsq(design, side)
    covariance = np.linalg.inv(design.T @ design) * np.outer(SCALES, SCALES)
    assert fused.knowledge.mean / SCALES == pytest.approx(solved, abs=1e-6)
    assert fused.knowledge.covariance / np.outer(SCALES, SCALES) == pytest.approx(
        covariance / np.outer(SCALES, SCALES), abs=1e-8
    )
    assert fused.chi_square == pytest.approx(float(rest[0]), rel=1e-6)


def test_an_event_with_parameters_of_its_own_is_least_squares_with_twice_as_many() -> None:
    """Chi-square, least over what the event may differ by, at any parameters."""
    rng = np.random.default_rng(5)
    known = knowledge(rng)
    seen = measurement(rng, known.mean, known.mean)
    evidence = Evidence.of([seen], known.mean)
    variance = np.where(np.arange(PARAMETER_COUNT) % 3 == 0, (0.3 * SCALES) ** 2, 0.0)
    free = variance > 0.0
    loosened = Evidence.of([seen], known.mean, variance=variance)
    for at in (known.mean, known.mean + SCALES):
        pull = (evidence.vector - evidence.matrix @ at)[free]
        own = np.linalg.solve(evidence.matrix[np.ix_(free, free)] + np.diag(1.0 / variance[free]), pull)
        moved = at.copy()
        moved[free] += own
        least = evidence.chi_square(moved) + float(np.sum(own**2 / variance[free]))
        assert loosened.chi_square(at) == pytest.approx(least, rel=1e-9)
    assert loosened.count == evidence.count
