"""Whether a bad lot of vehicles is found in time: many fleets drawn from one stock of simulated vehicles.

Of 200 vehicles ten have fluid that lasts half as long. Either they are one lot of fluid, or half of a lot of twenty, or
there is none. They were built in two months; months and plants are lots as well, and innocent.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Protocol, TypeVar

import numpy as np
from rich.table import Table

from benchmarks.prognosis.fleets import TYPE_LOG_STD, ageings_of_seed
from benchmarks.prognosis.lives import ERRORS, life_of
from benchmarks.prognosis.truth import Fleet
from diag_service.diagnosis.prognosis import Ageing, Lot, LotStanding, PeerGroup, learn, lot_standings

ResultT = TypeVar("ResultT")
BAD_FACTOR: Final = 0.5  # of the life
VEHICLES: Final = Fleet(life_log_std=TYPE_LOG_STD, stream=62)
FLEET_SIZE: Final = 200  # vehicles
LOOKS_KM: Final = (5_000.0, 7_500.0, 10_000.0, 12_500.0, 15_000.0, 17_500.0, 20_000.0, 25_000.0, 30_000.0)
BAD_COUNT: Final = 10  # of a fleet
FLEETS: Final = 200
MONTHS, PLANTS = 12, 3
ONE: Final = PeerGroup(vehicle_type="one", fluid="usual")
BAD_LOT: Final = Lot(name="fluid lot", value="00")
CASES: Final = {
    "no bad lot": (0, 10),
    "the whole lot is bad": (BAD_COUNT, 10),
    "half of the lot is bad": (BAD_COUNT, 20),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """One simulated vehicle: what it says at each look, and how long its fluid lasts."""

    looks: tuple[tuple[Ageing, ...], ...]
    life_km: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stock:
    """Vehicles of which fleets are drawn, with good and with bad fluid."""

    good: Sequence[Vehicle]
    bad: Sequence[Vehicle]


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What became of one fleet."""

    found_km: float | None  # at this look the bad lot was named first
    half_km: float  # where the median of the bad vehicles has lost half of its life
    named: int  # lots at any look
    false: int  # of them innocent
    named_vehicles: int  # that named lots hold
    false_vehicles: int  # of them sound

    @property
    def is_in_time(self) -> bool:
        """Whether the lot was named before half of the life was lost."""
        return self.found_km is not None and self.found_km < self.half_km


def vehicle_of(seed: int, *, is_bad: bool) -> Vehicle:
    """Return the vehicle of a seed, its fluid good or bad."""
    fleet = replace(VEHICLES, usual_km=VEHICLES.usual_km * (BAD_FACTOR if is_bad else 1.0))
    life = life_of(seed, ERRORS, fleet)
    looks = (ageings_of_seed(seed, "one", fleet, until_km) for until_km in LOOKS_KM)
    return Vehicle(
        looks=tuple(tuple(replace(one, kind=ONE) for one in look) for look in looks),
        life_km=life.truth.expected_km if life.begin_km else life.life_km,
    )


def drawn_from(stock: Stock, seed: int, bad_count: int) -> list[Vehicle]:
    """Return a fleet, the vehicles with bad fluid first."""
    return _drawn(stock, np.random.default_rng([seed, 70]), bad_count)


def _drawn(stock: Stock, rng: np.random.Generator, bad_count: int) -> list[Vehicle]:
    vehicles = [stock.bad[row] for row in rng.choice(len(stock.bad), bad_count, replace=False)]
    return vehicles + [stock.good[row] for row in rng.choice(len(stock.good), FLEET_SIZE - bad_count, replace=False)]


def found_in(seed: int, stock: Stock, bad_count: int, lot_size: int) -> Found:
    """Draw a fleet, look at it again and again, and return what was named."""
    rng = np.random.default_rng([seed, 70])
    vehicles = _drawn(stock, rng, bad_count)
    months = np.concatenate((rng.integers(0, 2, bad_count), rng.integers(0, MONTHS, FLEET_SIZE - bad_count)))
    plants = rng.integers(0, PLANTS, FLEET_SIZE)
    lots = {
        str(row): (
            Lot(name="fluid lot", value=f"{row // lot_size:02}"),
            Lot(name="month", value=f"{months[row]:02}"),
            Lot(name="plant", value=str(plants[row])),
        )
        for row in range(FLEET_SIZE)
    }
    named: dict[Lot, float] = {}
    for look, odometer_km in enumerate(LOOKS_KM):
        for one in _named(vehicles, look, lots):
            named.setdefault(one.lot, odometer_km)
    true = {BAD_LOT} if bad_count else set()
    members = {vehicle for vehicle, own in lots.items() if any(lot in named for lot in own)}
    return Found(
        found_km=named.get(BAD_LOT) if bad_count else None,
        half_km=0.5 * float(np.median([one.life_km for one in vehicles[:bad_count]])) if bad_count else 0.0,
        named=len(named),
        false=len(named.keys() - true),
        named_vehicles=len(members),
        false_vehicles=sum(int(vehicle) >= bad_count for vehicle in members),
    )


def _named(vehicles: Sequence[Vehicle], look: int, lots: dict[str, tuple[Lot, Lot, Lot]]) -> list[LotStanding]:
    lives = [replace(life, vehicle=str(row)) for row, one in enumerate(vehicles) for life in one.looks[look]]
    return [one for one in lot_standings(lives, learn(lives), lots) if one.is_named]


class Each(Protocol):
    """Does the same for many cases, maybe in several processes."""

    def __call__(self, work: Callable[[int], ResultT], cases: range, /) -> list[ResultT]:
        """Return the results of all cases in their order."""


def stock_of(first_seed: int, count: int, each: Each) -> Stock:
    """Simulate vehicles, of which a sixth is bad."""
    bad_count = max(count // 6, BAD_COUNT)
    return Stock(
        good=each(partial(vehicle_of, is_bad=False), range(first_seed, first_seed + count - bad_count)),
        bad=each(partial(vehicle_of, is_bad=True), range(first_seed + count - bad_count, first_seed + count)),
    )


def lots_table(stock: Stock, first_seed: int) -> Table:
    """Return whether bad lots are found, and what is named beside them."""
    table = Table(
        "fleets with", "fleets", "found in time", "found at, median", "any false lot", "false lots of named",
        "sound vehicles of named", title=f"Lots named in {len(LOOKS_KM)} looks at fleets of {FLEET_SIZE} vehicles",
    )  # fmt: skip
    for name, (bad_vehicles, lot_size) in CASES.items():
        work = partial(found_in, stock=stock, bad_count=bad_vehicles, lot_size=lot_size)
        found = [work(seed) for seed in range(first_seed, first_seed + FLEETS)]
        at_km = [one.found_km for one in found if one.found_km is not None]
        false = [one.false / max(one.named, 1) for one in found]
        sound = [one.false_vehicles / max(one.named_vehicles, 1) for one in found]
        table.add_row(
            name, str(FLEETS), _percent([one.is_in_time for one in found]) if bad_vehicles else "-",
            f"{float(np.median(at_km)):,.0f} km" if at_km else "-", _percent([one.false > 0 for one in found]),
            _percent(false), _percent(sound),
        )  # fmt: skip
    return table


def _percent(shares: Sequence[float]) -> str:
    return f"{100.0 * float(np.mean(shares)):.1f} %"
