"""Clutches that age faster than their peers: few false ones; and steps that all make at once."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis import ChannelName, Kind, Population, common_course, learn, standings
from diag_service.diagnosis.prognosis.outliers import discoveries
from diag_service.diagnosis.prognosis.population import Ageing, Course

COUNT = 400


def lives(seed: int, *, bad: int) -> list[Ageing]:
    rng = np.random.default_rng(seed)
    loss = 1.25e-8 * np.exp(0.2 * rng.standard_normal(COUNT))
    loss[:bad] *= 2.5
    seen = loss * np.exp(0.1 * rng.standard_normal(COUNT))
    kind = Kind(vehicle_type="dct", fluid=None)
    return [
        Ageing(
            vehicle=f"car{number}",
            clutch=1,
            kind=kind,
            distance_m=2.0e7,
            is_present=True,
            courses={ChannelName.MARGIN: Course(start=1.0, start_std=0.05, loss_per_m=one, loss_std_per_m=0.1 * one)},
        )
        for number, one in enumerate(seen.tolist())
    ]


def test_a_bad_batch_is_named_and_few_others_are() -> None:
    hits = false = 0
    for seed in range(5):
        fleet = lives(seed, bad=20)
        named = {one.ageing.vehicle for one in standings(fleet, learn(fleet)) if one.is_named}
        batch = {f"car{number}" for number in range(20)}
        hits += len(named & batch)
        false += len(named - batch)
    assert hits > 0.8 * 100
    assert false < 0.15 * (hits + false)  # a tenth is promised in the long run


def test_in_a_sound_fleet_hardly_ever_anybody_is_named() -> None:
    named = [
        any(one.is_named for one in standings(fleet, learn(fleet))) for fleet in (lives(s, bad=0) for s in range(20))
    ]
    assert sum(named) <= 3


def test_the_fastest_come_first_and_fluids_that_are_gone_do_not() -> None:
    fleet = lives(1, bad=1)
    gone = [replace(fleet[0], is_present=False), *fleet[1:]]
    found = standings(fleet, learn(fleet))
    assert found[0].ageing.vehicle == "car0"
    assert found[0].loss_ratio == pytest.approx(2.5, rel=0.5)
    assert [one.z for one in found] == sorted((one.z for one in found), reverse=True)
    assert "car0" not in {one.ageing.vehicle for one in standings(gone, learn(gone))}
    assert standings(fleet, Population(life_count=0, peers=())) == []


def test_discoveries_are_those_of_benjamini_and_hochberg() -> None:
    # Benjamini and Hochberg (1995), table of section 3.2: four of fifteen at 0.05
    small = (0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459)
    p = np.array([*small, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0000])
    assert np.flatnonzero(discoveries(p[::-1], 0.05)).tolist() == [11, 12, 13, 14]
    assert not discoveries(np.array([0.5, 0.9]), 0.1).any()
    assert discoveries(np.zeros(0), 0.1).tolist() == []


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
