"""How far the fluid of one clutch will go: what its past results say, never as a single number."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import FrictionCurve
from clutch_model.units import degc_from_k
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO, level_at
from clutch_results.prognosis.assumptions import (
    HAND_FACTOR,
    HAND_SHARE,
    HORIZON_M,
    KNEE_PROBABILITY,
    LEAST_ROWS,
    LOAD_LOG_STD,
    REFERENCE_K,
    SERVICE_DISTANCE_M,
    SURE_OF_AGEING,
)
from clutch_results.prognosis.changes import FluidStart, fluid_starts
from clutch_results.prognosis.channels import DISTANCE_M
from clutch_results.prognosis.fluid_lives import CHANGE_MARGIN_RATIO, FluidLife, either, fluid_lives
from clutch_results.prognosis.history import History
from clutch_results.prognosis.population import Peers
from clutch_results.prognosis.trend import Passage

M_PER_KM = 1000.0
PERCENT = 100.0


def _of_kind(peers: Peers | None) -> Iterator[str]:
    """Yield how ageing may bend, and with what it begins, by what the fleet tells of such clutches."""
    chance = KNEE_PROBABILITY if peers is None else peers.bend_chance
    source = (
        f", as in {peers.bend_life_count} lives of this type" if peers is not None and peers.bend_life_count else ""
    )
    at_hand = f"{HAND_FACTOR:g} times as fast at once in {PERCENT * HAND_SHARE * chance:.0f} %"
    chances = f"{PERCENT * chance:.0f} % of lives{source}, {at_hand}"
    yield f"ageing may become clearly faster before the limit is passed: at some share of the life in {chances}"
    if peers is not None:
        fluid = "any fluid" if peers.kind.fluid is None else peers.kind.fluid
        which = "" if peers.version is None else f" (population {peers.version})"
        yield f"before its own results, new fluid ages as in {peers.life_count} lives of this type with {fluid}{which}"


def _assumptions(history: History, starts: tuple[FluidStart, ...], service_distance_m: float) -> Iterator[str]:
    yield (
        f"watch: margin below {PERCENT * WATCH_MARGIN_RATIO:.0f} % of that of new fluid, or mu_C below "
        f"{PERCENT * WATCH_LEVEL_RATIO:.0f} % of new or of its own start"
    )
    yield f"change_fluid: margin gone, or mu_C below {PERCENT * CHANGE_LEVEL_RATIO:.0f} % of new or of its own start"
    yield f"friction as at {degc_from_k(REFERENCE_K):.0f} degC of the oil"
    yield f"the load stays as it was lately, within {PERCENT * LOAD_LOG_STD:.0f} % (one deviation)"
    horizon = f"{HORIZON_M / M_PER_KM:,.0f} km"
    yield f"the next service is {service_distance_m / M_PER_KM:,.0f} km ahead; there is no forecast beyond {horizon}"
    yield "torque gain, piston area and sensors drift no more than fluid ages: results cannot tell the two apart"
    for start in starts:
        if not start.is_noted:
            yield f"new fluid at about {start.odometer_m / M_PER_KM:,.0f} km, inferred from friction, not noted"
    counted = "distance" if history.slip_energy_j is None else "distance, slip energy"
    yield f"fluid ages by {counted} or heat of the oil, and may do so ever slower or faster: the results decide"
    if history.left_out_count:
        why = "no odometer or oil temperature, or odometer went back or leapt"
        yield f"{history.left_out_count} results are left out: {why}"


class Outlook(StrEnum):
    """What can be said of the future of a clutch."""

    TOO_FEW = "too few results"
    NO_TREND = "no trend yet"
    AGEING = "ageing"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """Distance until a limit is passed: at most that far with 10, 50 and 90 % probability.

    None is farther than the horizon.
    """

    p10_m: float | None
    p50_m: float | None
    p90_m: float | None
    probability_before_service: float
    passage: Passage


@dataclass(frozen=True, slots=True, kw_only=True)
class Prognosis:
    """What is to be expected of one clutch; everything is None where the outlook is TOO_FEW."""

    clutch: int
    outlook: Outlook
    row_count: int  # results with this fluid
    service_distance_m: float
    fluid_starts: tuple[FluidStart, ...]
    assumptions: tuple[str, ...]
    left_out_count: int = 0  # results that no prognosis can use
    stale_since_s: float | None = None  # UTC, of the last result that can be used, where later ones cannot
    watch: Reach | None = None
    change_fluid: Reach | None = None
    life: FluidLife | None = field(default=None, repr=False)  # of the present fluid so far


def prognose(
    clutch: int,
    history: History,
    reference: FrictionCurve,
    *,
    service_distance_m: float = SERVICE_DISTANCE_M,
    peers: Peers | None = None,
) -> Prognosis:
    """Return what is to be expected of clutch 1 or 2 from its history; the reference is its friction with new fluid.

    Peers say what is usual for its kind; without them little is assumed.
    """
    starts = fluid_starts(history) if len(history) else ()
    row_count = len(history) - starts[-1].row if starts and not history.is_fluid_newer else 0
    blank = Prognosis(
        clutch=clutch,
        outlook=Outlook.TOO_FEW,
        row_count=row_count,
        service_distance_m=service_distance_m,
        fluid_starts=starts,
        assumptions=(*_assumptions(history, starts, service_distance_m), *_of_kind(peers)),
        left_out_count=history.left_out_count,
        stale_since_s=float(history.end_s[-1]) if history.is_stale else None,
    )
    if row_count < LEAST_ROWS:
        return blank
    today = fluid_lives(history, starts, reference, peers)[-1]
    sure = max(channel.probability_falling for channel in today.channels.values())
    watch = either(today, WATCH_MARGIN_RATIO, WATCH_LEVEL_RATIO)
    change = either(today, CHANGE_MARGIN_RATIO, CHANGE_LEVEL_RATIO)
    return replace(
        blank,
        outlook=Outlook.AGEING if sure >= SURE_OF_AGEING else Outlook.NO_TREND,
        watch=_reach(watch, service_distance_m),
        change_fluid=_reach(change, service_distance_m),
        life=today,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """What will be left of the friction margin of a clutch (`margin_left`) if the fluid stays in."""

    distance_m: FloatArray  # (d,) from today
    quantiles: FloatArray  # (3, d) less than this is left with 10, 50 and 90 % probability


_LEFT = np.linspace(-0.2, 1.2, 36)  # margins of which the passage is looked at
_SHARES = (0.1, 0.5, 0.9)
_POINTS = 64  # of a forecast: of long ones every second or third distance is drawn


def forecast(prognosis: Prognosis, within_m: float) -> Forecast | None:
    """Return the margin at distances within some from today; None where the outlook is TOO_FEW."""
    if prognosis.life is None or prognosis.change_fluid is None:
        return None
    step = 1 + int(np.count_nonzero(prognosis.change_fluid.passage.probability <= _SHARES[-1])) // _POINTS
    distance_m = DISTANCE_M[: np.searchsorted(DISTANCE_M, within_m, side="right") : step]
    count, before, passed = len(distance_m), np.zeros_like(distance_m), np.ones((len(_LEFT), len(distance_m)))
    for row, left in enumerate(_LEFT.tolist()):
        when = either(prognosis.life, left, level_at(left), slice(0, count * step, step))
        passed[row, :count] = before = np.maximum(before[:count], when.probability)
        count = int(np.count_nonzero(before <= _SHARES[-1]))  # farther on less is left with every share
    quantiles = [np.interp(_SHARES, column, _LEFT) for column in passed.T]
    return Forecast(distance_m=distance_m, quantiles=np.transpose(quantiles))


def _reach(when: Passage, service_distance_m: float) -> Reach:
    return Reach(
        p10_m=when.quantile_m(0.1),
        p50_m=when.quantile_m(0.5),
        p90_m=when.quantile_m(0.9),
        probability_before_service=when.within(service_distance_m),
        passage=when,
    )
