"""The median is numpy's, bit by bit."""

import numpy as np
import pytest

from diag_service.diagnosis.quality.data_quality import median


@pytest.mark.parametrize("count", [1, 2, 3, 8, 193, 1820])
def test_it_is_that_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == np.median(values)
