"""Which lots of vehicles age faster than the others: what was filled or built together fails together.

A lot shows long before its single clutches do. Each has an e-value: how much likelier its losses are if the lot is bad
than if it is not, on average over how bad it may be. An e-value stays one however often it is looked at (Ville), and
e-values need not be independent to bound the share of false ones among those named (Wang, Ramdas 2022).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from diag_service.diagnosis.prognosis.channels import ChannelName
from diag_service.diagnosis.prognosis.population import Ageing, Course, Population, Usual, location_and_scatter

FALSE_SHARE: Final = 0.10  # of the lots that are named
LEAST_VEHICLES: Final = 3  # of a lot: fewer are single vehicles
LOT_LOG_STD: Final = 0.05  # by which sound lots differ, natural logarithm of the loss
BAD_RATIOS: Final = (1.25, 1.5, 2.0, 3.0)  # of the loss of bad lots, each as likely as the other
MOST_Z: Final = 3.0  # of one vehicle: none speaks for its lot alone


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Lot:
    """What some vehicles have in common: a property, as the lot of fluid or the month of building, and its value."""

    name: str
    value: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LotStanding:
    """How one lot stands among all vehicles."""

    lot: Lot
    vehicle_count: int  # that say something, without those of worse lots named before
    loss_ratio: float  # of the margin, over that of the peers
    loss_ratio_log_std: float
    e_value: float
    is_named: bool  # ages faster, by more than chance


@dataclass(frozen=True, slots=True, kw_only=True)
class _Vehicle:
    """How fast the fluid in one vehicle ages against its peers: natural logarithm, and its deviation."""

    log_ratio: float
    std: float


def lot_standings(
    lives: Sequence[Ageing],
    population: Population,
    lots: Mapping[str, Sequence[Lot]],
    *,
    false_share: float = FALSE_SHARE,
) -> list[LotStanding]:
    """Return how lots stand, those that are named first; ``lots`` are those of each vehicle.

    The worst lot is named first, and its vehicles do not speak for other lots any more: a month in which a bad fluid
    was filled is not bad by itself.
    """
    vehicles = _vehicles(lives, population)
    members: dict[Lot, set[str]] = {}
    for vehicle in vehicles:
        for lot in lots.get(vehicle, ()):
            members.setdefault(lot, set()).add(vehicle)
    members = {lot: own for lot, own in members.items() if len(own) >= LEAST_VEHICLES}
    count, named = len(members), list[LotStanding]()
    while members:
        found = [_standing(lot, [vehicles[one] for one in sorted(own)]) for lot, own in sorted(members.items())]
        worst = max(found, key=lambda one: one.e_value)
        if worst.e_value < count / (false_share * (len(named) + 1)):
            return [*named, *sorted(found, key=lambda one: -one.e_value)]
        named.append(replace(worst, is_named=True))
        gone = members.pop(worst.lot)
        left = {lot: own - gone for lot, own in members.items()}
        members = {lot: own for lot, own in left.items() if len(own) >= LEAST_VEHICLES}
    return named


def _vehicles(lives: Sequence[Ageing], population: Population) -> dict[str, _Vehicle]:
    """Return how fast the fluid that is in now ages in each vehicle, about the middle of all."""
    rows: dict[str, list[tuple[float, float]]] = {}
    for life in lives:
        peers = population.of(life.kind.vehicle_type, life.kind.fluid)
        usual = None if peers is None else peers.channels.get(ChannelName.MARGIN)
        course = life.courses.get(ChannelName.MARGIN)
        if life.is_present and usual is not None and course is not None:
            rows.setdefault(life.vehicle, []).append(z_score(course, usual))
    if not rows:
        return {}
    z, std = np.array([np.mean(own, axis=0) for own in rows.values()]).T
    middle, spread = location_and_scatter(z, np.zeros_like(z))  # what is usual is what most vehicles do
    z = np.clip((z - middle) / max(spread, 1.0), -MOST_Z, MOST_Z)
    return {
        name: _Vehicle(log_ratio=float(one * wide), std=float(wide))
        for name, one, wide in zip(rows, z, std, strict=True)
    }


def _standing(lot: Lot, own: Sequence[_Vehicle]) -> LotStanding:
    weight = np.array([one.std for one in own]) ** -2.0
    mean = float(np.average([one.log_ratio for one in own], weights=weight))
    variance = 1.0 / float(weight.sum()) + LOT_LOG_STD**2
    effect = np.log(BAD_RATIOS)
    return LotStanding(
        lot=lot,
        vehicle_count=len(own),
        loss_ratio=float(np.exp(mean)),
        loss_ratio_log_std=variance**0.5,
        e_value=float(np.mean(np.exp((effect * mean - 0.5 * effect**2) / variance))),
        is_named=False,
    )


def z_score(course: Course, usual: Usual) -> tuple[float, float]:
    """Return by how many deviations a loss is more than usual, and how much one is; scatter is that of logarithms."""
    faster = max(course.loss_per_m, 0.0) / usual.loss_per_m
    if faster <= 1.0:
        std = float(np.hypot(course.loss_std_per_m / usual.loss_per_m, usual.loss_log_std))
        return (course.loss_per_m / usual.loss_per_m - 1.0) / std, std
    std = float(np.hypot(usual.loss_log_std, course.loss_std_per_m / course.loss_per_m))
    return float(np.log(faster)) / std, std
