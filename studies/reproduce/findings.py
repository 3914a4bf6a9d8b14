"""The studies of the reproduction, run in order with progress, and kept together for the report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from diag_service.diagnosis.friction.paper.friction_data import NOISY_GATES
from studies.reproduce.bound import bounds_percent
from studies.reproduce.can_route import can_errors
from studies.reproduce.drives import Case, PaperDrive, drive, noisy, static_tables, trajectory_tables
from studies.reproduce.evidence import StaticEvidence, static_evidence
from studies.reproduce.film_check import known_film_errors
from studies.reproduce.pictures import Picture, pictures, run_of
from studies.reproduce.readings import Reading, readings, variants
from studies.reproduce.study import (
    Errors,
    Key,
    Setup,
    matched_differentiators,
    noiseless_errors,
    noisy_errors,
)

VARIANT_SEEDS = 10  # draws of the noise behind each reading and the evidence, at most
CAN_SEEDS = 5  # drives behind the vehicle route, at most
PICTURE_SEED = 1

Stage = Callable[[str, int], Callable[[], None]]
"""Opens a stage of so many steps by name; what it returns is called after each step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """Everything the report speaks of."""

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


def find(seed_count: int, open_stage: Stage) -> Findings:
    """Run every study."""
    seeds = range(1, seed_count + 1)
    few, can_seeds = seeds[:VARIANT_SEEDS], seeds[:CAN_SEEDS]
    advance = open_stage("driving three cycles with each parameter set", len(Case))
    drives = []
    for case in Case:
        drives.append(drive(case))
        advance()
    tables, other_tables = static_tables(), trajectory_tables()
    clean = Setup(tables=tables)
    setup = Setup(tables=tables, differentiators=matched_differentiators(drives[0]), gates=NOISY_GATES)
    advance = open_stage("the Cramér-Rao bound", len(drives))
    bounds: dict[Key, float] = {}
    for one in drives:
        bounds |= bounds_percent(one)
        advance()
    advance = open_stage("noisy sensor sets", len(drives) * len(seeds))
    noisy_found = noisy_errors(drives, setup, seeds, advance)
    advance = open_stage("what passes the gates", len(drives) * len(few))
    evidence = [found for one in drives for found in static_evidence(one, setup, few, advance)]
    variant_count = len(variants(setup, other_tables, drives[0]))
    advance = open_stage("other readings of the text", variant_count * len(drives) * len(few))
    found_readings = readings(drives, setup, other_tables, few, advance)
    advance = open_stage("CAN frames by the vehicle route", len(drives) * len(can_seeds))
    can = can_errors(drives, can_seeds, advance)
    advance = open_stage("pictures", 12)
    drawn = []
    for picture in pictures(
        drives[0], run_of(drives[0].signals, clean), run_of(noisy(drives[0].signals, PICTURE_SEED), setup)
    ):
        drawn.append(picture)
        advance()
    return Findings(
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
        pictures=sorted(drawn, key=lambda one: one.number),
    )
