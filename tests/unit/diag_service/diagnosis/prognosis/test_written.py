"""A population survives being written; what is none is refused."""

import json
from collections.abc import Callable
from typing import Any

import pytest

from diag_service.diagnosis.prognosis import (
    ChannelName,
    Common,
    PeerGroup,
    Peers,
    Population,
    Usual,
    population_from,
    population_record,
)
from diag_service.diagnosis.prognosis.assumptions import KNEE_PROBABILITY

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
