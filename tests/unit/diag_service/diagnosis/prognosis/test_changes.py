"""Steps of a course: fluid that nobody noted, and what a whole fleet shows."""

from dataclasses import replace

import numpy as np
import pytest

from clutch_results.prognosis import common_of, monthly, without
from clutch_results.prognosis.changes import fluid_starts
from clutch_results.prognosis.history import History
from clutch_results.prognosis.population import PERIOD_S
from tests.support.pasts import ageing, past

COUNT = 300
WARMTH_K = 25.0 * np.sin(np.arange(COUNT) / 20.0)


def with_step(row: int, *, noise_ratio: float = 0.02, seed: int = 1) -> History:
    """Return a fluid that ages until a row, and new fluid from there on."""
    margin = np.concatenate((ageing(row, until=0.35), ageing(COUNT - row, until=0.6)))
    level = np.concatenate((np.linspace(1.0, 0.95, row), np.linspace(1.0, 0.97, COUNT - row)))
    return past(margin, level=level, noise_ratio=noise_ratio, seed=seed)


@pytest.mark.parametrize("row", [40, 150, 250])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_forgotten_fill_is_found_within_fifteen_results(row: int, seed: int) -> None:
    first, second = fluid_starts(with_step(row, seed=seed).first(row + 15))
    assert (first.row, first.is_noted, second.is_noted) == (0, True, False)
    assert abs(second.row - row) <= 4
    assert second.noticed_row < row + 15


@pytest.mark.parametrize("seed", range(6))
def test_ageing_warmth_and_noise_are_no_fill(seed: int) -> None:
    aged = past(ageing(COUNT, until=0.0), noise_ratio=0.03, warmth_k=WARMTH_K, seed=seed)
    warm = replace(aged, mu_c=aged.mu_c * (1.0 - 3.0e-4 * WARMTH_K), mu_s=aged.mu_s * (1.0 + 3.0e-4 * WARMTH_K))
    assert len(fluid_starts(warm)) == 1


@pytest.mark.parametrize("rows", [25, 60, 120])
@pytest.mark.parametrize("seed", range(3))
def test_a_fall_that_ends_is_no_new_fluid(rows: int, seed: int) -> None:
    margin = np.concatenate((np.ones(150), np.linspace(1.0, 0.5, rows), np.full(150 - rows, 0.5)))
    assert len(fluid_starts(past(margin, noise_ratio=0.02, seed=seed))) == 1


def test_a_noted_fill_is_not_found_again() -> None:
    noted = replace(with_step(150), fluid_number=(np.arange(COUNT) >= 150).astype(np.int64), new_fluids=(0, 1))
    assert [(start.row, start.is_noted) for start in fluid_starts(noted)] == [(0, True), (150, True)]


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
