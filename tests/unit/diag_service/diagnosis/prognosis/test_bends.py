"""How lives bend is learned from what came of them."""

import numpy as np
import pytest

from diag_service.diagnosis.prognosis.assumptions import FUTURE_BENDS
from diag_service.diagnosis.prognosis.channels import DISTANCE_M
from diag_service.diagnosis.prognosis.population import Hindsight, bends_of
from diag_service.diagnosis.prognosis.trend import Passage, normal_cdf

LEFT_M = 5.0e7
SURE = Passage(distance_m=DISTANCE_M, probability=normal_cdf((DISTANCE_M - LEFT_M) / (0.05 * LEFT_M)))


def life(factor: float, place: float = 0.5, *, followed: float | None = None) -> list[Hindsight]:
    """Return a look at a life of which the rate changed by a factor at some part of what was left."""
    left_m = LEFT_M * (place + (1.0 - place) / factor)
    is_seen = followed is None or left_m < followed * LEFT_M
    known_m = left_m if followed is None or is_seen else followed * LEFT_M
    return [Hindsight(share=0.25, left_m=known_m, has_ended=is_seen, passage=SURE)]


def faster(bends: dict[float, float]) -> float:
    return sum(chance for factor, chance in bends.items() if factor >= 1.5)


def slower(bends: dict[float, float]) -> float:
    return sum(chance for factor, chance in bends.items() if factor < 1.0)


def test_lives_that_never_bend_take_the_assumed_bends_away() -> None:
    (found,) = (dict(one) for one in bends_of({"van": [life(1.0)] * 200}).values())
    assert faster(found) < 0.05 < sum(FUTURE_BENDS.values())
    few = dict(bends_of({"van": [life(1.0)] * 8})["van"])
    assert faster(found) < faster(few) < sum(FUTURE_BENDS.values())


def test_as_many_bends_are_learned_as_there_were_and_in_their_direction() -> None:
    places = np.linspace(0.05, 0.8, 30)
    lives = [life(2.0, place) for place in places] + [life(0.5, place) for place in places[::2]] + [life(1.0)] * 105
    found = dict(bends_of({"van": lives})["van"])
    assert faster(found) == pytest.approx(0.2, abs=0.07)
    assert slower(found) == pytest.approx(0.1, abs=0.05)


def test_lives_that_go_on_count_for_what_they_went_through() -> None:
    lives = [life(0.5, 0.1, followed=1.3)] * 60  # none has ended where all would have, had nothing bent
    found = dict(bends_of({"van": lives})["van"])
    assert slower(found) > 0.6
    assert faster(found) < 0.1


def test_a_type_with_few_lives_bends_as_all_do() -> None:
    groups = {"many": [life(3.0, place) for place in np.linspace(0.05, 0.6, 100)], "few": [life(1.0)] * 4}
    found = bends_of(groups)
    assert faster(dict(found["few"])) > 0.6
