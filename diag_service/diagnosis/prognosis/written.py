"""A population as JSON: what `fleet-backend peers --keep` stores, and `diag-service history --peers` reads."""

from collections.abc import Mapping
from math import isfinite
from typing import Any, Final

from diag_service.diagnosis.prognosis.channels import ChannelName
from diag_service.diagnosis.prognosis.common import Common
from diag_service.diagnosis.prognosis.population import PeerGroup, Peers, Population, Usual

SCHEMA: Final = "clutchdiag/population/v1"
_USUAL: Final = ("start", "start_std", "loss_per_m", "loss_log_std")


def population_record(population: Population) -> dict[str, Any]:
    """Return a population as it is written, JSON-ready."""
    return {
        "schema": SCHEMA,
        "version": population.version,
        "life_count": population.life_count,
        "peers": [
            {
                "vehicle_type": one.kind.vehicle_type,
                "fluid": one.kind.fluid,
                "life_count": one.life_count,
                "channels": {
                    name.value: {key: getattr(usual, key) for key in _USUAL} for name, usual in one.channels.items()
                },
                "bends": [{"factor": factor, "chance": chance} for factor, chance in one.bends.items()],
                "bend_life_count": one.bend_life_count,
            }
            for one in population.peers
        ],
        "common": [
            {"vehicle_type": name, "first_period": one.first_period, "mu_c": one.mu_c, "mu_s": one.mu_s}
            for name, one in population.common.items()
        ],
    }


def population_from(record: object) -> Population:
    """Return the population that a record holds.

    Raises
    ------
    ValueError
        If it is none, or one of a newer program.
    """
    if not isinstance(record, Mapping) or record.get("schema") != SCHEMA:
        raise ValueError(f"no population of the schema {SCHEMA}")
    try:
        return Population(
            version=None if record["version"] is None else int(record["version"]),
            life_count=int(record["life_count"]),
            peers=tuple(_peers(one) for one in record["peers"]),
            common={str(one["vehicle_type"]): _common(one) for one in record["common"]},
        )
    except (KeyError, TypeError, AttributeError) as exc:
        raise ValueError(f"a population lacks something: {exc}") from exc


def _peers(record: Mapping[str, Any]) -> Peers:
    fluid = record["fluid"]
    return Peers(
        kind=PeerGroup(vehicle_type=str(record["vehicle_type"]), fluid=None if fluid is None else str(fluid)),
        life_count=int(record["life_count"]),
        channels={
            ChannelName(name): Usual(**{key: _number(usual[key]) for key in _USUAL})
            for name, usual in record["channels"].items()
        },
        bends={_number(one["factor"]): _number(one["chance"]) for one in record["bends"]},
        bend_life_count=int(record["bend_life_count"]),
    )


def _common(record: Mapping[str, Any]) -> Common:
    mu_c, mu_s = (tuple(map(_number, record[name])) for name in ("mu_c", "mu_s"))
    if not mu_c or len(mu_c) != len(mu_s):
        raise ValueError("common courses of mu_C and mu_S differ in length")
    return Common(first_period=int(record["first_period"]), mu_c=mu_c, mu_s=mu_s)


def _number(value: object) -> float:
    number = float(str(value))
    if not isfinite(number):
        raise ValueError(f"{value!r} is not a number of a population")
    return number
