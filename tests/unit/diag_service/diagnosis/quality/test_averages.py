"""Mean and median are numpy's, bit by bit."""

import numpy as np
import pytest

from diag_service.diagnosis.quality.data_quality import mean, median


@pytest.mark.parametrize("count", [1, 2, 3, 8, 193, 1820])
def test_they_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert mean(values) == np.mean(values)
    assert median(values) == np.median(values)
