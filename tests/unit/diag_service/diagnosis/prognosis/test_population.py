"""What a population teaches, and its file."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clutch_results.prognosis import (
    ChannelName,
    Common,
    PeerGroup,
    Peers,
    Population,
    Usual,
    ageings,
    learn,
    population_from,
    population_record,
    prognose,
)
from clutch_results.prognosis.assumptions import KNEE_PROBABILITY
from clutch_results.prognosis.population import Ageing, Course, location_and_scatter
from tests.support.pasts import REFERENCE, past

KIND = PeerGroup(vehicle_type="dct", fluid="75W")


def life(loss_per_m: float, *, kind: PeerGroup = KIND, doubt: float = 0.1) -> Ageing:
    course = Course(start=1.02, start_std=0.05, loss_per_m=loss_per_m, loss_std_per_m=doubt * loss_per_m)
    return Ageing(kind=kind, courses={ChannelName.MARGIN: course})


def fleet(count: int, *, log_std: float, kind: PeerGroup = KIND, seed: int = 1) -> list[Ageing]:
    rng = np.random.default_rng(seed)
    true = 1.25e-8 * np.exp(log_std * rng.standard_normal(count))
    seen = true * np.exp(0.1 * rng.standard_normal(count))
    return [life(float(loss), kind=kind) for loss in seen]


def test_the_scatter_of_a_fleet_is_without_the_doubt_of_each() -> None:
    rng = np.random.default_rng(3)
    std = rng.uniform(0.1, 0.4, 2000)
    value = 2.0 + 0.3 * rng.standard_normal(2000) + std * rng.standard_normal(2000)
    centre, scatter = location_and_scatter(value, std)
    assert centre == pytest.approx(2.0, abs=0.03)
    assert scatter == pytest.approx(0.3, abs=0.04)
    value[:100] += 5.0  # a bad batch of a twentieth
    centre, scatter = location_and_scatter(value, std)
    assert centre == pytest.approx(2.0, abs=0.08)
    assert scatter == pytest.approx(0.3, abs=0.08)


@pytest.mark.parametrize("is_bent", [False, True])
def test_how_often_lives_bend_is_learned_of_types_with_enough_that_ended(is_bent: bool) -> None:
    at = np.linspace(0.0, 1.0, 300)
    worn = at + 3.0 * np.maximum(at - 0.7, 0.0) if is_bent else at
    history = past(1.0 - 1.2 * worn / worn[-1], step_m=2.0e5, noise_ratio=0.004)
    (ended,) = ageings(history, REFERENCE, [KIND])
    assert (ended.bent_odds > 3.0) is is_bent
    few, enough = (learn([*fleet(20, log_std=0.2), *[ended] * count]).peers[0] for count in (7, 25))
    assert (few.bend_chance, few.bend_life_count) == (KNEE_PROBABILITY, 0)
    assert enough.bend_life_count == 25
    assert enough.bend_chance > 0.6 if is_bent else enough.bend_chance < 0.6 * KNEE_PROBABILITY


def test_a_new_vehicle_begins_with_its_population() -> None:
    few = past(np.ones(12), step_m=5.0e4, noise_ratio=0.02)
    peers = learn(fleet(60, log_std=0.15)).of("dct", "75W")
    alone, among = prognose(1, few, REFERENCE), prognose(1, few, REFERENCE, peers=peers)
    assert alone.change_fluid is not None
    assert among.change_fluid is not None
    widths = [
        np.ptp(one.passage.quantiles_m(np.array([0.25, 0.75]))) for one in (alone.change_fluid, among.change_fluid)
    ]
    assert widths[1] < 0.75 * widths[0]
    median_m = among.change_fluid.p50_m
    assert median_m is not None
    assert 4.5e7 < median_m < 9.0e7  # 80,000 km, less what bends may take
    assert any("60 lives" in line for line in among.assumptions)


POPULATION = Population(
    life_count=40,
    version=3,
    peers=(
        Peers(
            kind=PeerGroup(vehicle_type="dct", fluid=None),
            life_count=40,
            channels={ChannelName.MARGIN: Usual(start=1.0, start_std=0.1, loss_per_m=1.2e-8, loss_log_std=0.21)},
            bend_chance=0.12,
            bend_life_count=31,
        ),
    ),
    common={"dct": Common(first_period=600, mu_c=(0.0, 0.01), mu_s=(0.0, 0.0))},
)


def test_what_is_written_is_read_to_the_last_digit() -> None:
    again = population_from(json.loads(json.dumps(population_record(POPULATION))))
    assert again == POPULATION
    found = again.of("dct", "a fluid of its own")
    assert found is not None
    assert found.version == 3


def test_a_population_of_an_older_program_assumes_how_often_lives_bend() -> None:
    record: dict[str, Any] = json.loads(json.dumps(population_record(POPULATION)))
    del record["peers"][0]["bend_chance"]
    (peers,) = population_from(record).peers
    assert (peers.bend_chance, peers.bend_life_count) == (KNEE_PROBABILITY, 0)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda record: record.pop("peers"),
        lambda record: record.update(schema="clutchdiag/population/v2"),
        lambda record: record["peers"][0]["channels"]["margin"].update(start="wide"),
        lambda record: record["peers"][0]["channels"]["margin"].update(start=float("nan")),
        lambda record: record["peers"][0]["channels"].update(colour={}),
        lambda record: record["common"][0].update(mu_s=[0.0]),
        lambda record: record.update(peers=7),
    ],
)
def test_what_is_no_population_is_refused(spoil: Callable[[dict[str, Any]], Any]) -> None:
    record: dict[str, Any] = json.loads(json.dumps(population_record(POPULATION)))
    spoil(record)
    with pytest.raises(ValueError, match=r"."):
        population_from(record)
