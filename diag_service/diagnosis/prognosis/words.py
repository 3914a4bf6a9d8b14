"""What a prognosis rests on, in words and numbers."""

from collections.abc import Iterator

from clutch_model.units import degc_from_k
from diag_service.diagnosis.condition.verdict import (
    CHANGE_LEVEL_RATIO,
    WATCH_LEVEL_RATIO,
    WATCH_MARGIN_RATIO,
)
from diag_service.diagnosis.prognosis.assumptions import (
    FUTURE_BENDS,
    HORIZON_M,
    LOAD_LOG_STD,
    REFERENCE_K,
)
from diag_service.diagnosis.prognosis.changes import FluidStart
from diag_service.diagnosis.prognosis.history import History
from diag_service.diagnosis.prognosis.population import Peers

M_PER_KM = 1000.0
CLEAR_BEND = 1.5  # factor of the rate
_PERCENT = 100.0


def assumptions_of(
    history: History, starts: tuple[FluidStart, ...], service_distance_m: float, peers: Peers | None
) -> tuple[str, ...]:
    """Return the assumptions of a prognosis, one sentence each."""
    return (*_assumptions(history, starts, service_distance_m), *_of_bends(peers), *_of_peers(peers))


def _of_bends(peers: Peers | None) -> Iterator[str]:
    if peers is not None and peers.bend_life_count:
        faster = sum(chance for factor, chance in peers.bends.items() if factor >= CLEAR_BEND)
        yield (
            f"ageing may bend before the limit is passed as in {peers.bend_life_count} lives of this type, "
            f"{_PERCENT * faster:.0f} % of them to {CLEAR_BEND:g} times the rate or more"
        )
        return
    factors = " or ".join(f"{factor:g}" for factor in FUTURE_BENDS)
    chance = sum(FUTURE_BENDS.values())
    yield f"ageing may become {factors} times as fast before the limit is passed, {_PERCENT * chance:.0f} % in all"


def _of_peers(peers: Peers | None) -> Iterator[str]:
    if peers is not None:
        fluid = "any fluid" if peers.kind.fluid is None else peers.kind.fluid
        which = "" if peers.version is None else f" (population {peers.version})"
        yield f"before its own results, new fluid ages as in {peers.life_count} lives of this type with {fluid}{which}"


def _assumptions(history: History, starts: tuple[FluidStart, ...], service_distance_m: float) -> Iterator[str]:
    yield (
        f"watch: margin below {_PERCENT * WATCH_MARGIN_RATIO:.0f} % of that of new fluid, or mu_C below "
        f"{_PERCENT * WATCH_LEVEL_RATIO:.0f} % of new or of its own start"
    )
    yield f"change_fluid: margin gone, or mu_C below {_PERCENT * CHANGE_LEVEL_RATIO:.0f} % of new or of its own start"
    yield f"friction as at {degc_from_k(REFERENCE_K):.0f} degC of the oil"
    yield f"the load stays as it was lately, within {_PERCENT * LOAD_LOG_STD:.0f} % (one deviation)"
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
