"""What the fluids of the fleet have in common, by type and fluid."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

from sqlalchemy import Engine, select

from clutch_model.calibration import FrictionCurve
from clutch_results.prognosis import (
    Ageing,
    Common,
    History,
    Monthly,
    PeerGroup,
    Population,
    ageings,
    common_of,
    history_of_estimates,
    learn,
    monthly,
    without,
)
from fleet_backend.database import transaction
from fleet_backend.page.calibrations import reference_of, type_of
from fleet_backend.page.prognosis import BEYOND_NUMBERS, estimate_of, fluid_fill
from fleet_backend.page.queries import fills_of, results_of
from fleet_backend.schema import CLUTCH

Key = tuple[str, int]  # vehicle and clutch
Record = Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetAgeing:
    """What was learned of a fleet; JSON-ready records."""

    population: Population
    usual: Sequence[Record]
    clutch_count: int  # looked at
    left_out_count: int  # of them: of a calibration that is not at hand, or of numbers of no clutch


@dataclass(frozen=True, slots=True, kw_only=True)
class _Clutch:
    vehicle: str
    clutch: int
    vehicle_type: str
    history: History
    reference: FrictionCurve
    kinds: Sequence[PeerGroup]

    def ageings(self) -> list[Ageing] | None:
        """Return what its fluids say; None where its numbers are of no clutch."""
        try:
            return ageings(self.vehicle, self.clutch, self.history, self.reference, self.kinds)
        except BEYOND_NUMBERS:
            return None


def fleet_ageing(engine: Engine) -> FleetAgeing:
    """Learn from all clutches of a fleet, one after the other.

    They do not fit into memory together, so they are read twice: for what all share, then without that.
    """
    with transaction(engine) as connection:
        order = (CLUTCH.c.vehicle, CLUTCH.c.clutch)
        keys = [(str(vehicle), int(clutch)) for vehicle, clutch in connection.execute(select(*order).order_by(*order))]
    common = _common(engine, keys)
    read = partial(_clutch, engine, common)
    told = ((key, one.ageings()) for key in keys if (one := read(key)) is not None)
    lives = {key: own for key, own in told if own is not None}
    population = replace(learn(list(chain.from_iterable(lives.values()))), common=common)
    return FleetAgeing(
        population=population,
        usual=list(_usual(population)),
        clutch_count=len(keys),
        left_out_count=len(keys) - len(lives),
    )


def _common(engine: Engine, keys: Sequence[Key]) -> dict[str, Common]:
    """Return what the clutches of each type share."""
    months: dict[str, list[Monthly]] = {}
    for key in keys:
        one = _clutch(engine, {}, key)
        if one is not None:
            months.setdefault(one.vehicle_type, []).extend(monthly(one.history))
    found = {name: common_of(clutches) for name, clutches in months.items()}
    return {name: one for name, one in found.items() if one is not None}


def _clutch(engine: Engine, common: Mapping[str, Common], key: Key) -> _Clutch | None:
    """Return a clutch without what its type shares; None where it cannot be told how its fluid ages."""
    vehicle, clutch = key
    rows = results_of(engine, vehicle, clutch)
    calibration = str(rows[-1]["calibration_version"]) if rows else ""
    reference, vehicle_type = reference_of(vehicle, calibration, clutch), type_of(vehicle, calibration)
    if reference is None:
        return None
    fills = fills_of(engine, vehicle)
    same = [estimate_of(row) for row in rows if row["calibration_version"] == calibration]
    try:
        past = history_of_estimates(same, [fluid_fill(vehicle, one) for one in fills], clutch)
    except BEYOND_NUMBERS:
        return None
    return _Clutch(
        vehicle=vehicle,
        clutch=clutch,
        vehicle_type=vehicle_type,
        history=without(past, common.get(vehicle_type)),
        reference=reference,
        kinds=[PeerGroup(vehicle_type=vehicle_type, fluid=name) for name in (None, *(one.product for one in fills))],
    )


def _usual(population: Population) -> Iterator[Record]:
    for peers in population.peers:
        for name, usual in peers.channels.items():
            yield {
                "record": "usual",
                "vehicle_type": peers.kind.vehicle_type,
                "fluid": peers.kind.fluid,
                "channel": name.value,
                "life_count": peers.life_count,
                "start": usual.start,
                "start_std": usual.start_std,
                "loss_per_m": usual.loss_per_m,
                "loss_log_std": usual.loss_log_std,
                "bend_life_count": peers.bend_life_count,
                "bend_chance": peers.bend_chance,
            }
