"""Whether a bad batch is found of which no table knows: many fleets drawn from one stock of simulated vehicles.

Beside it stands an oracle that knows how the readings of sound and of bad vehicles are distributed at each look, from
the whole stock: what it cannot tell no test of readings can.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from rich.table import Table

from benchmarks.prognosis.fleets import BATCH_SIZE, LOOKS_KM
from benchmarks.prognosis.lots import BAD_COUNT, FLEETS, Stock, Vehicle, drawn_from
from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis import ChannelName, hidden_batches
from diag_service.diagnosis.prognosis.batches import YOUNG_M

M_PER_KM: Final = 1000.0
LOOKS: Final = tuple(look for look, km in enumerate(LOOKS_KM) if km * M_PER_KM <= YOUNG_M)
ORACLE_LOG_RATIO: Final = float(np.log(10.0))
WIDTH: Final = 0.12  # of the oracle's kernels, natural logarithm of the loss
LEAST: Final = 1e-4  # density: no reading is impossible


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What is said at one look: vehicles by their numbers, those of the batch are the first."""

    is_found: bool
    likeliest: tuple[int, ...]  # as many as are bad
    named: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What became of one fleet."""

    found_km: float | None
    in_time: Seen | None  # the last look before half of the life was lost at which there was found a batch
    is_any: bool  # a batch was found at any look


Look = Callable[[Sequence[Vehicle], int], Seen | None]


def by_the_fleet(vehicles: Sequence[Vehicle], look: int) -> Seen | None:
    """Return what the readings of a fleet say by themselves."""
    lives = [replace(life, vehicle=str(row)) for row, one in enumerate(vehicles) for life in one.looks[look]]
    for found in hidden_batches(lives):
        order = tuple(int(name) for name in found.probability)
        named = tuple(int(name) for name in found.named)
        return Seen(is_found=found.is_found, likeliest=order[:BAD_COUNT], named=named)
    return None


def oracle_of(stock: Stock) -> Look:
    """Return who knows how readings are distributed."""
    known = [tuple(_logs(some, look) for some in (stock.good, stock.bad)) for look in range(len(LOOKS_KM))]

    def look_at(vehicles: Sequence[Vehicle], look: int) -> Seen | None:
        value, share = _logs(vehicles, look), BAD_COUNT / BATCH_SIZE
        good, bad = (_density(value, one) for one in known[look])
        ratio = np.where(np.isfinite(value), bad / good, 0.0)
        chance = share * ratio / (1.0 - share + share * ratio)
        order = np.argsort(-chance)
        sound = np.cumsum(1.0 - chance[order]) / np.arange(1, len(order) + 1)
        return Seen(
            is_found=float(np.sum(np.log1p(share * (ratio - 1.0)))) >= ORACLE_LOG_RATIO,
            likeliest=tuple(order[:BAD_COUNT].tolist()),
            named=tuple(order[: int(np.sum(sound <= 0.1))].tolist()),
        )

    return look_at


def _logs(vehicles: Sequence[Vehicle], look: int) -> FloatArray:
    """Return the logarithms of the losses, NaN where nothing is known, shape (n,)."""
    found = np.full(len(vehicles), np.nan)
    for row, one in enumerate(vehicles):
        for life in one.looks[look]:
            if life.is_present and ChannelName.MARGIN in life.courses:
                found[row] = np.log(max(life.courses[ChannelName.MARGIN].loss_per_m * 1e8, 1e-3))
    return found


def _density(at: FloatArray, known: FloatArray) -> FloatArray:
    known = known[np.isfinite(known)]
    kernels = np.exp(-0.5 * ((np.nan_to_num(at)[:, None] - known) / WIDTH) ** 2)
    return np.asarray(np.maximum(kernels.sum(axis=1) / len(known) / WIDTH, LEAST))


def result_of(vehicles: Sequence[Vehicle], bad_count: int, look_at: Look) -> Result:
    """Look at a fleet again and again."""
    half_km = 0.5 * float(np.median([one.life_km for one in vehicles[:bad_count]])) if bad_count else 0.0
    seen = [(LOOKS_KM[look], look_at(vehicles, look)) for look in LOOKS]
    found = [(km, one) for km, one in seen if one is not None and one.is_found]
    in_time = [one for km, one in found if km < half_km]
    return Result(
        found_km=found[0][0] if in_time else None, in_time=in_time[-1] if in_time else None, is_any=bool(found)
    )


def hidden_table(stock: Stock, first_seed: int, fleets: int = FLEETS) -> Table:
    """Return whether a batch is found, and how far its members are known."""
    table = Table(
        "who looks", "fleets", "without a batch, found one", "with one, found in time", "found at, median",
        "of the ten likeliest bad", "bad ones named", "of those named sound",
        title=f"A bad batch of {BAD_COUNT} among {BATCH_SIZE} of which no table knows",
    )  # fmt: skip
    for name, look_at in (("the fleet's readings", by_the_fleet), ("oracle that knows their laws", oracle_of(stock))):
        seeds = range(first_seed, first_seed + fleets)
        sound = [result_of(drawn_from(stock, seed, 0), 0, look_at) for seed in seeds]
        bad = [result_of(drawn_from(stock, seed, BAD_COUNT), BAD_COUNT, look_at) for seed in seeds]
        at_km = [one.found_km for one in bad if one.found_km is not None]
        told = [one.in_time for one in bad if one.in_time is not None]
        hits = [sum(row < BAD_COUNT for row in one.named) for one in told]
        wrong = [(len(one.named) - hit) / max(len(one.named), 1) for one, hit in zip(told, hits, strict=True)]
        likely = [sum(row < BAD_COUNT for row in one.likeliest) for one in told]
        table.add_row(
            name, str(fleets), f"{100.0 * np.mean([one.is_any for one in sound]):.1f} %",
            f"{100.0 * len(told) / fleets:.1f} %", f"{np.median(at_km):,.0f} km" if at_km else "-",
            *(f"{np.mean(some):.1f}" if some else "-" for some in (likely, hits)),
            f"{100.0 * np.mean(wrong):.1f} %" if wrong else "-",
        )  # fmt: skip
    return table
