"""What all clutches of a type do at once is found and taken out of each."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis import History, common_of, monthly, without
from diag_service.diagnosis.prognosis.population import PERIOD_S
from tests.support.pasts import ageing, past

UPDATE = 6  # month in which a software reads mu_S by two percent more


def driven(seed: int, *, updated: bool = True) -> History:
    """Return a year of results, twenty a month."""
    one = past(ageing(240), noise_ratio=0.01, seed=seed)
    month = np.arange(240) // 20
    factor = np.where(updated & (month >= UPDATE), 1.02, 1.0)
    return replace(one, end_s=(600.0 + np.arange(240) / 20.0) * PERIOD_S, mu_s=one.mu_s * factor)


def test_a_step_that_all_make_is_found_and_taken_out() -> None:
    fleet = [driven(seed) for seed in range(12)]
    common = common_of(means for one in fleet for means in monthly(one))
    assert common is not None
    assert common.first_period == 600
    assert common.mu_s[UPDATE - 1] == pytest.approx(0.0, abs=0.004)
    assert common.mu_s[-1] == pytest.approx(np.log(1.02), abs=0.006)
    assert common.mu_c == pytest.approx(np.zeros(12), abs=0.004)
    plain = driven(0, updated=False)
    np.testing.assert_allclose(without(driven(0), common).mu_s, plain.mu_s, rtol=0.006)
