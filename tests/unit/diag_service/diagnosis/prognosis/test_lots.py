"""A lot of which all members age a little faster is named; what only holds its members is not."""

from dataclasses import replace

import numpy as np

from diag_service.diagnosis.prognosis import Ageing, ChannelName, Lot, PeerGroup, learn, lot_standings
from diag_service.diagnosis.prognosis.population import Course

KIND = PeerGroup(vehicle_type="dct", fluid="75W")
BAD = Lot(name="fluid", value="07")


def fleet(ratio: float, *, seed: int = 1, doubt: float = 0.15) -> list[Ageing]:
    """Return 120 vehicles with both clutches, the first ten of them with losses that are so much larger."""
    rng = np.random.default_rng(seed)
    lives = []
    for number in range(120):
        own = 1.25e-8 * np.exp(0.25 * rng.standard_normal()) * (ratio if number < 10 else 1.0)
        for clutch in (1, 2):
            loss = float(own * np.exp(doubt * rng.standard_normal()))
            course = Course(start=1.0, start_std=0.05, loss_per_m=loss, loss_std_per_m=doubt * loss)
            life = Ageing(
                vehicle=f"car{number:03}",
                clutch=clutch,
                kind=KIND,
                distance_m=2.0e7,
                is_present=True,
                courses={ChannelName.MARGIN: course},
            )
            lives.append(life)
    return lives


def lots() -> dict[str, list[Lot]]:
    """Return lots of ten, months of which one holds the first lot and as many others, and one plant for all."""
    return {
        f"car{number:03}": [
            replace(BAD, value=f"{7 + number // 10:02}"),
            Lot(name="month", value=str(number // 20)),
            Lot(name="plant", value="north"),
        ]
        for number in range(120)
    }


def test_a_lot_that_ages_faster_is_named_and_the_month_that_holds_it_is_not() -> None:
    lives = fleet(1.9)
    found = lot_standings(lives, learn(lives), lots())
    assert [one.lot for one in found if one.is_named] == [BAD]
    assert found[0].vehicle_count == 10
    assert 1.5 < found[0].loss_ratio < 2.3
    month = next(one for one in found if one.lot == Lot(name="month", value="0"))
    assert month.vehicle_count == 10  # those of the named lot no longer speak for it


def test_sound_fleets_hardly_ever_have_a_bad_lot() -> None:
    fleets = [fleet(1.0, seed=seed) for seed in range(15)]
    named = [one.lot for lives in fleets for one in lot_standings(lives, learn(lives), lots()) if one.is_named]
    assert not named


def test_a_lot_that_differs_by_little_or_is_small_is_not_named() -> None:
    little = fleet(1.08)
    assert not any(one.is_named for one in lot_standings(little, learn(little), lots()))
    lives = fleet(3.0)
    few = {vehicle: own[:1] for vehicle, own in lots().items() if vehicle not in {f"car{n:03}" for n in range(2, 10)}}
    assert BAD not in {one.lot for one in lot_standings(lives, learn(lives), few)}


def test_one_wild_vehicle_does_not_convict_its_lot() -> None:
    lives = fleet(1.0)
    wild = [replace(one, courses=tenfold(one)) if one.vehicle == "car003" else one for one in lives]
    assert not any(one.is_named for one in lot_standings(wild, learn(wild), lots()))


def tenfold(one: Ageing) -> dict[ChannelName, Course]:
    course = one.courses[ChannelName.MARGIN]
    loss = 10.0 * course.loss_per_m
    return {ChannelName.MARGIN: replace(course, loss_per_m=loss, loss_std_per_m=0.15 * loss)}


def test_without_peers_or_lots_nothing_is_said() -> None:
    lives = fleet(1.9)
    assert lot_standings(lives, learn(lives), {}) == []
    assert lot_standings(lives[:4], learn(lives[:4]), lots()) == []
