"""The study of prognoses: scores against known values, simulated lives, and the command."""

from enum import StrEnum
from statistics import NormalDist

import numpy as np
import pytest

from benchmarks.prognosis.__main__ import main
from benchmarks.prognosis.baselines import fixed_interval, fleet, logistic_index, whole_line
from benchmarks.prognosis.kinds import KINDS, Kind, kind_life_of, straight_line, usual_life
from benchmarks.prognosis.lives import DRIVEN_KM, Life, life_of
from benchmarks.prognosis.scores import PROBABILITIES, crps, is_covered, is_near
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


def test_the_score_of_a_number_is_its_error() -> None:
    assert crps(np.full((2, 99), 5.0), np.array([3.0, 9.0])).tolist() == pytest.approx([2.0, 4.0])


def test_inside_and_near() -> None:
    assert is_covered(np.array([0.04, 0.06, 0.5, 0.94, 0.96])).tolist() == [0.0, 1.0, 1.0, 1.0, 0.0]
    assert is_near(np.array([79.0, 81.0, 119.0, 121.0]), np.full(4, 100.0)).tolist() == [0.0, 1.0, 1.0, 0.0]


def test_a_seed_is_a_life(lives: dict[StrEnum, Life]) -> None:
    again = life_of(SEEDS[0])
    first = lives[again.stratum]
    np.testing.assert_array_equal(again.history.mu_c, first.history.mu_c)
    assert (again.watch_km, again.change_km) == (first.watch_km, first.change_km)
    assert life_of(SEEDS[0] + len(Stratum)).change_km != again.change_km


def test_every_kind_of_life_is_there_and_fluid_is_watched_before_it_is_changed(lives: dict[StrEnum, Life]) -> None:
    assert set(lives) == set(Stratum)
    for life in lives.values():
        assert life.begin_km < life.watch_km < life.change_km
        assert life.history.odometer_m[-1] < DRIVEN_KM * 1000.0


def test_only_a_noted_fill_is_in_the_history(lives: dict[StrEnum, Life]) -> None:
    noted, forgotten = lives[Stratum.KNOWN_FILL], lives[Stratum.FORGOTTEN_FILL]
    assert np.unique(noted.history.fluid_number).tolist() == [0, 1]
    assert np.unique(forgotten.history.fluid_number).tolist() == [0]
    assert forgotten.forgotten_km == forgotten.begin_km > 0.0
    assert noted.forgotten_km is None


def test_missing_data_are_missing(lives: dict[StrEnum, Life]) -> None:
    assert len(lives[Stratum.GAPS].history) < 0.8 * len(lives[Stratum.STEADY].history)
    assert np.diff(lives[Stratum.GAPS].history.odometer_m).max() > 5.0e6


def test_baselines_say_what_their_names_say(lives: dict[StrEnum, Life]) -> None:
    assert fixed_interval(20_000.0).tolist() == [40_000.0] * len(PROBABILITIES)
    assert fixed_interval(70_000.0).max() == 0.0
    left_km = fleet(50_000.0, np.array([40_000.0, 60_000.0, 100_000.0]))
    assert 10_000.0 <= left_km.min() <= left_km.max() <= 50_000.0
    assert fleet(500_000.0, np.array([40_000.0])).max() == 0.0
    life = lives[Stratum.STEADY]
    half_km = 0.5 * life.life_km
    past = life.history.first(life.rows_until(half_km))
    for quantiles in (whole_line(past), logistic_index(past)):
        assert np.ptp(quantiles) == 0.0
        assert 0.2 * half_km < quantiles[0] < 5.0 * half_km


def test_lives_by_other_laws_end_and_repeat() -> None:
    lives = [wear_life_of(seed) for seed in range(900, 900 + len(Course))]
    assert [life.stratum for life in lives] == list(Course)
    for life in lives:
        assert life.begin_km < life.watch_km < life.change_km
    np.testing.assert_array_equal(wear_life_of(900).history.mu_c, lives[0].history.mu_c)
    assert {isinstance(mixed_life_of(seed).stratum, Course) for seed in range(900, 910)} == {False, True}


def test_the_command_compares_lives_of_three_simulators(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--simulators", "--lives", "1", "--seed", "905"]) == 0
    text = capsys.readouterr().out
    for expected in ("power law", "random wear", "either", "slowing wear"):
        assert expected in text


def test_the_command_prints_its_three_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--lives", "1", "--seed", "907"]) == 0
    text = capsys.readouterr().out
    for expected in ("1 lives, seeds from 907", "All lives", "By kind of life", "forgotten fills found within 15"):
        assert expected in text


def test_four_kinds_of_lives_wear_from_new_to_nothing_and_repeat() -> None:
    for kind, life in zip(KINDS, map(kind_life_of, range(900, 904)), strict=True):
        assert life.kind is kind
        assert len(life.until(0.25)) < len(life.until(0.9)) < len(life.history)
        assert (life.begin_km > 0.0) is (kind is Kind.FILL)
        assert (life.knee_share < 1.0) is (kind is Kind.LATE_KNEE)
    np.testing.assert_array_equal(kind_life_of(900).history.mu_c, kind_life_of(900).history.mu_c)


def test_the_rivals_know_even_lives_and_what_is_usual() -> None:
    life = kind_life_of(900)
    quantiles, number_km = straight_line(life.until(0.9))
    assert quantiles[0] < number_km < quantiles[-1]
    assert number_km == pytest.approx(0.1 * life.life_km, rel=0.5)
    assert np.median(usual_life(1.0)) == pytest.approx(85_000.0, rel=0.01)
    assert 0.0 <= usual_life(150_000.0)[0] < np.median(usual_life(150_000.0)) < 60_000.0


def test_the_command_compares_four_kinds_with_both_rivals(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--kinds", "--lives", "4", "--seed", "900"]) == 0
    text = capsys.readouterr().out
    for expected in ("linear", "bursts", "noted fill", "late knee", "knee + 5 %"):
        assert expected in text
