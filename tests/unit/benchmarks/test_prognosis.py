"""The study of prognoses: scores against known values, simulated lives, and the command."""

from enum import StrEnum
from statistics import NormalDist

import numpy as np
import pytest

from benchmarks.prognosis.__main__ import main
from benchmarks.prognosis.lives import Life, life_of
from benchmarks.prognosis.scores import crps
from benchmarks.prognosis.truth import Stratum
from benchmarks.prognosis.wear import Course, mixed_life_of, wear_life_of

SEEDS = range(900, 900 + len(Stratum))


@pytest.fixture(scope="module")
def lives() -> dict[StrEnum, Life]:
    return {life.stratum: life for life in map(life_of, SEEDS)}


@pytest.mark.parametrize("truth", [-1.0, 0.0, 0.7, 3.0])
def test_the_score_of_a_normal_forecast_is_the_known_one(truth: float) -> None:
    normal = NormalDist()
    quantiles = np.array([[normal.inv_cdf((row + 0.5) / 4000) for row in range(4000)]])
    known = truth * (2.0 * normal.cdf(truth) - 1.0) + 2.0 * normal.pdf(truth) - np.pi**-0.5
    assert crps(quantiles, np.array([truth])).item() == pytest.approx(known, abs=2e-3)


def test_a_seed_is_a_life(lives: dict[StrEnum, Life]) -> None:
    again = life_of(SEEDS[0])
    first = lives[again.stratum]
    np.testing.assert_array_equal(again.history.mu_c, first.history.mu_c)
    assert (again.watch_km, again.change_km) == (first.watch_km, first.change_km)
    assert life_of(SEEDS[0] + len(Stratum)).change_km != again.change_km


def test_lives_by_other_laws_end_and_repeat() -> None:
    lives = [wear_life_of(seed) for seed in range(900, 900 + len(Course))]
    assert [life.stratum for life in lives] == list(Course)
    for life in lives:
        assert life.begin_km < life.watch_km < life.change_km
    np.testing.assert_array_equal(wear_life_of(900).history.mu_c, lives[0].history.mu_c)
    assert {isinstance(mixed_life_of(seed).stratum, Course) for seed in range(900, 910)} == {False, True}


def test_the_command_prints_its_three_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--lives", "1", "--seed", "907"]) == 0
    text = capsys.readouterr().out
    for expected in ("1 lives, seeds from 907", "All lives", "By kind of life", "forgotten fills found within 15"):
        assert expected in text
