"""A batch of which no table knows is found among all vehicles; scatter and a few wild ones are none."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis import Ageing, ChannelName, Kind, hidden_batches
from diag_service.diagnosis.prognosis.batches import LEAST_VEHICLES, YOUNG_M
from diag_service.diagnosis.prognosis.population import Course

KIND = Kind(vehicle_type="dct", fluid="75W")


def fleet(ratio: float, *, seed: int, count: int = 200, scatter: float = 0.25) -> list[Ageing]:
    """Return vehicles of which the first twentieth has losses that are so much larger."""
    rng = np.random.default_rng(seed)
    true = 1.25e-8 * np.exp(scatter * rng.standard_normal(count))
    true[: count // 20] *= ratio
    seen = true + 0.15e-8 * rng.standard_normal(count)
    return [
        Ageing(
            vehicle=f"car{number:03}",
            clutch=1,
            kind=KIND,
            distance_m=1.5e7,
            is_present=True,
            courses={ChannelName.MARGIN: Course(start=1.0, start_std=0.05, loss_per_m=one, loss_std_per_m=0.15e-8)},
        )
        for number, one in enumerate(seen.tolist())
    ]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_hidden_batch_is_found_and_its_members_are_the_likeliest(seed: int) -> None:
    (found,) = hidden_batches(fleet(2.2, seed=seed, scatter=0.2))
    assert found.is_found
    assert found.vehicle_count == 200
    assert 1.5 <= found.loss_ratio <= 3.0
    likeliest = list(found.probability)[:10]
    assert sum(int(name[3:]) < 10 for name in likeliest) >= 7
    assert sum(int(name[3:]) >= 10 for name in found.named) <= 0.2 * max(len(found.named), 1)


def test_scatter_of_any_width_and_wild_vehicles_are_no_batch() -> None:
    for scatter in (0.1, 0.25, 0.4):
        assert [one.is_found for one in hidden_batches(fleet(1.0, seed=3, scatter=scatter))] == [False]
    one, other, *rest = fleet(1.0, seed=4)
    wild = [replace(car, courses={ChannelName.MARGIN: Course(
        start=1.0, start_std=0.05, loss_per_m=8.0e-8, loss_std_per_m=0.15e-8)}) for car in (one, other)]  # fmt: skip
    assert [one.is_found for one in hidden_batches([*wild, *rest])] == [False]


def test_few_vehicles_and_old_fluids_say_nothing() -> None:
    lives = fleet(2.0, seed=5)
    assert hidden_batches(lives[: LEAST_VEHICLES - 1]) == []
    assert hidden_batches([replace(life, distance_m=YOUNG_M + 1.0) for life in lives]) == []
    assert hidden_batches([replace(life, is_present=False) for life in lives]) == []
