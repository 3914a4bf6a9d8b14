"""The selection of events that costs least, against all selections that there are."""

from itertools import product

import numpy as np
import pytest

from diag_service.diagnosis.friction.evidence import PARAMETER_COUNT, Evidence, Knowledge, Measurement, fuse
from diag_service.diagnosis.friction.judgement import omission_cost, selected

NUMBERS = 10
FAR = 12.0  # standard deviations


def known() -> Knowledge:
    return Knowledge(mean=np.zeros(PARAMETER_COUNT), covariance=np.eye(PARAMETER_COUNT))


def evidence(shift: float, rng: np.random.Generator, row: int = 0) -> Evidence:
    """Return an event that sees one parameter, and finds it shifted."""
    slope = np.zeros((NUMBERS, PARAMETER_COUNT))
    slope[:, row] = 1.0
    seen = Measurement(residual=shift + rng.normal(size=NUMBERS), slope=slope, noise=np.eye(NUMBERS))
    return Evidence.of([seen], known().mean)


def cost(evidences: list[Evidence], used: tuple[bool, ...]) -> float:
    total = Evidence.none()
    for one, is_used in zip(evidences, used, strict=True):
        total = total.plus(one) if is_used else total
    left_out = sum(omission_cost(one) for one, is_used in zip(evidences, used, strict=True) if not is_used)
    return fuse(known(), total).chi_square + left_out


@pytest.mark.parametrize(
    "shifts",
    [
        (0.0,) * 5,
        (FAR, 0.0, 0.0, 0.0, 0.0),
        (FAR, FAR, 0.0, 0.0, 0.0),
        (FAR, FAR, FAR, 0.0, 0.0),
        (FAR, FAR),
        (FAR, -FAR, 2.0 * FAR, 0.0),
        (2.0 * FAR,) * 4,
    ],
)
@pytest.mark.parametrize("seed", range(5))
def test_no_other_selection_costs_less(shifts: tuple[float, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    evidences = [evidence(shift, rng) for shift in shifts]
    found = selected(known(), evidences)
    assert found.cost == pytest.approx(cost(evidences, found.is_used))
    assert found.cost == pytest.approx(
        min(cost(evidences, used) for used in product((True, False), repeat=len(shifts)))
    )
