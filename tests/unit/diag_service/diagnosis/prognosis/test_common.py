"""What all clutches of a type do at once is found and taken out of each."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis import Common, History, common_course, common_of, monthly, without
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


def test_results_after_what_is_known_keep_the_last_of_it() -> None:
    common = Common(first_period=600, mu_c=(0.0, 0.1), mu_s=(0.0, 0.0))
    later = driven(1)
    np.testing.assert_allclose(without(later, common).mu_c[20:], later.mu_c[20:] * np.exp(-0.1))
    np.testing.assert_allclose(without(later, common).mu_c[:20], later.mu_c[:20])
    assert without(later, None) is later


def test_fleets_without_a_step_or_with_many_fills_share_nothing() -> None:
    assert common_of([]) is None
    sound = [driven(seed, updated=False) for seed in range(12)]
    assert common_of(means for one in sound for means in monthly(one)) is None
    filled = [
        replace(one, fluid_number=(np.arange(240) >= 20 * UPDATE).astype(np.int64)) for one in map(driven, range(12))
    ]
    assert common_of(means for one in filled for means in monthly(one)) is None  # each fluid begins anew


def test_a_step_of_all_is_common_and_one_of_a_single_clutch_is_its_own() -> None:
    rng = np.random.default_rng(5)
    clutch, period = (one.ravel() for one in np.meshgrid(np.arange(40), np.arange(12)))
    fall = -0.01 * np.exp(0.2 * rng.standard_normal(40))[clutch] * period
    value = 1.0 + fall + 0.004 * rng.standard_normal(len(period)) + 0.03 * (period >= 5)
    value -= 0.2 * ((clutch == 3) & (period >= 8))
    is_there = rng.random(len(period)) < 0.9
    course = common_course(period[is_there], clutch[is_there], value[is_there])
    assert course[:5].tolist() == [0.0] * 5
    np.testing.assert_allclose(course[5:], 0.03, atol=0.004)
    alone = common_course(period[clutch < 3], clutch[clutch < 3], value[clutch < 3])
    assert not alone.any()  # three clutches do not say what is common
