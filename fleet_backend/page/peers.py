"""What the fluids of the fleet have in common, by type and fluid, and which clutches age faster than their peers."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import Engine, select

from diag_service.diagnosis.prognosis import (
    Ageing,
    ChannelName,
    Kind,
    Population,
    ageings,
    history_of_estimates,
    learn,
    standings,
)
from fleet_backend.database import transaction
from fleet_backend.page.outlook import estimate_of, fluid_fill, reference_of
from fleet_backend.page.past import fills_of, results_of
from fleet_backend.schema import CLUTCH

Record = Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetAgeing:
    """What was learned of a fleet, and how each clutch stands in it; JSON-ready records."""

    usual: Sequence[Record]
    clutches: Sequence[Record]  # the fastest first
    clutch_count: int  # looked at
    left_out_count: int  # of them: of a calibration that is not at hand


def fleet_ageing(engine: Engine) -> FleetAgeing:
    """Learn from all clutches of a fleet, one after the other, and hold each against its peers."""
    with transaction(engine) as connection:
        order = (CLUTCH.c.vehicle, CLUTCH.c.clutch)
        keys = [(str(vehicle), int(clutch)) for vehicle, clutch in connection.execute(select(*order).order_by(*order))]
    lives: list[Ageing] = []
    left_out = 0
    for vehicle, clutch in keys:
        found = _ageings(engine, vehicle, clutch)
        left_out += found is None
        lives += found or []
    population = learn(lives)
    return FleetAgeing(
        usual=list(_usual(population)),
        clutches=list(_standings(lives, population)),
        clutch_count=len(keys),
        left_out_count=left_out,
    )


def _ageings(engine: Engine, vehicle: str, clutch: int) -> list[Ageing] | None:
    """Return what the fluids of a clutch say; None where the friction of new fluid is not known."""
    rows = results_of(engine, vehicle, clutch)
    calibration = str(rows[-1]["calibration_version"]) if rows else ""
    reference = reference_of(calibration, clutch)
    if reference is None:
        return None
    fills = fills_of(engine, vehicle)
    same = [estimate_of(row) for row in rows if row["calibration_version"] == calibration]
    past = history_of_estimates(same, [fluid_fill(vehicle, one) for one in fills], clutch)
    kinds = [Kind(vehicle_type=calibration, fluid=name) for name in (None, *(one.product for one in fills))]
    return ageings(vehicle, clutch, past, reference, kinds)


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
            }


def _standings(lives: Sequence[Ageing], population: Population) -> Iterator[Record]:
    for one in standings(lives, population):
        life = one.ageing
        yield {
            "record": "clutch",
            "vehicle": life.vehicle,
            "clutch": life.clutch,
            "fluid": life.kind.fluid,
            "distance_m": life.distance_m,
            "loss_per_m": life.courses[ChannelName.MARGIN].loss_per_m,
            "loss_ratio": one.loss_ratio,
            "z": one.z,
            "probability": one.probability,
            "is_faster_than_peers": one.is_named,
        }
