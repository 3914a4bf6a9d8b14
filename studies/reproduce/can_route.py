"""The paper's method on what a vehicle offers: CAN frames, decoded, with the torques of the vehicle route."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from diag_service.diagnosis.friction.paper import PaperCollection, PaperEstimate
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.scenario import FluidCondition
from ecu_emulator.scenario.scenario_file import load_scenario
from studies.builders import new_decoder, to_batch
from studies.reproduce.drives import CYCLE_COUNT, Case, PaperDrive
from studies.reproduce.study import CALIBRATION, DRIVELINE, Errors, errors_of

SCENARIO = "noise_only"
FLUID = {Case.IDEAL: FluidCondition.IDEAL, Case.CASE_1: FluidCondition.CASE_1, Case.CASE_2: FluidCondition.CASE_2}


def can_errors(drives: Sequence[PaperDrive], seeds: range, advance: Callable[[], None]) -> Errors:
    """Return the errors on CAN frames of drives with sensor noise only, a new drive for every seed."""
    found: dict[Case, list[tuple[PaperEstimate, PaperEstimate]]] = {case: [] for case in FLUID}
    for case in FLUID:
        for seed in seeds:
            found[case].append(_estimates(case, seed))
            advance()
    return errors_of(found, drives)


def _estimates(case: Case, seed: int) -> tuple[PaperEstimate, PaperEstimate]:
    scenario = load_scenario(SCENARIO)
    fluid = replace(scenario.fluid, condition=FLUID[case])
    frames, _ = frames_of(replace(scenario, seed=seed, cycles=CYCLE_COUNT, fluid=fluid))
    decoder, finder = new_decoder(), ShiftFinder()
    collection = PaperCollection(CALIBRATION, DRIVELINE)
    for columns in decoder.feed(to_batch(frames)):
        for event in finder.feed(columns):
            collection.add(event)
    first, second = (clutch.estimate for clutch in collection.pooled())
    nothing = PaperEstimate(mu_c=None, mu_s=None, static_counts={}, coulomb_counts={})
    return first or nothing, second or nothing
