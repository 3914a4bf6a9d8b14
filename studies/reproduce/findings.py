"""The studies of the reproduction, run in order with progress, and kept together for the report."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from diag_service.diagnosis.friction.paper.method import NOISY_GATES
from studies.reproduce.bound import bounds_percent
from studies.reproduce.drives import PaperCase, PaperDrive, drive, noisy, static_tables, trajectory_tables
from studies.reproduce.evidence import StaticEvidence, static_evidence
from studies.reproduce.pictures import Picture, pictures, run_of
from studies.reproduce.study import (
    Errors,
    Key,
    Setup,
    matched_differentiators,
    noiseless_errors,
    noisy_errors,
)
from studies.reproduce.variants import Reading, can_errors, known_film_errors, readings

VARIANT_SEEDS = 10  # draws of the noise behind each reading and the evidence, at most
CAN_SEEDS = 5  # drives behind the vehicle route, at most
PICTURE_SEED = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperFindings:
    """Everything the report speaks of."""

    cycles: int
    drives: Sequence[PaperDrive]
    seeds: range
    noiseless: Errors
    noiseless_trajectory: Errors
    noiseless_known_film: Errors
    noisy: Errors
    noisy_setup: Setup
    bounds: Mapping[Key, float]
    evidence: Sequence[StaticEvidence]
    readings: Sequence[Reading]
    reading_seeds: range
    can: Errors
    can_seeds: range
    pictures: Sequence[Picture]


def find(seed_count: int, cycles: int) -> PaperFindings:
    """Run every study; which of them is at work goes to stderr."""

    def tell(what: str) -> None:
        print(what, file=sys.stderr, flush=True)

    seeds = range(1, seed_count + 1)
    few, can_seeds = seeds[:VARIANT_SEEDS], seeds[:CAN_SEEDS]
    tell("driving three cycles with each parameter set")
    drives = [drive(case, cycles=cycles) for case in PaperCase]
    tables, other_tables = static_tables(), trajectory_tables()
    clean = Setup(tables=tables)
    setup = Setup(tables=tables, differentiators=matched_differentiators(drives[0]), gates=NOISY_GATES)
    tell("the Cramér-Rao bound")
    bounds = {key: bound for driven in drives for key, bound in bounds_percent(driven).items()}
    tell("noisy sensor sets")
    (noisy_found,) = noisy_errors(drives, [setup], seeds)
    tell("what passes the gates")
    evidence = [found for driven in drives for found in static_evidence(driven, setup, few)]
    tell("other readings of the text")
    found_readings = readings(drives, setup, other_tables, few)
    tell("CAN frames by the vehicle route")
    can = can_errors(drives, can_seeds, cycles)
    tell("pictures")
    runs = run_of(drives[0].signals, clean), run_of(noisy(drives[0].signals, PICTURE_SEED), setup)
    return PaperFindings(
        cycles=cycles,
        drives=drives,
        seeds=seeds,
        noiseless=noiseless_errors(drives, clean),
        noiseless_trajectory=noiseless_errors(drives, Setup(tables=other_tables)),
        noiseless_known_film=known_film_errors(drives, clean),
        noisy=noisy_found,
        noisy_setup=setup,
        bounds=bounds,
        evidence=evidence,
        readings=found_readings,
        reading_seeds=few,
        can=can,
        can_seeds=can_seeds,
        pictures=sorted(pictures(drives[0], *runs), key=lambda picture: picture.number),
    )
