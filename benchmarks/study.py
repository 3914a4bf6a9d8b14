"""What studies over many drives share: the way from a scenario to its diagnoses, processes with progress, percents."""

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from benchmarks.accuracy import to_batch
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.scenario import Scenario
from ecu_emulator.truth import TruthLog

CaseT = TypeVar("CaseT")
ResultT = TypeVar("ResultT")

REPORT_EVERY = 20  # drives


def diagnose(scenario: Scenario) -> tuple[list[Diagnosis], TruthLog]:
    """Drive a scenario in memory, frames and decoding included, and return what the service makes of its shifts."""
    frames, truth = frames_of(scenario)
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    return stages.feed(to_batch(frames)), truth


def over_drives(work: Callable[[CaseT], list[ResultT]], cases: Sequence[CaseT], jobs: int) -> list[ResultT]:
    """Return the results of all cases in their order, worked on by ``jobs`` processes; progress goes to stderr."""
    results: list[ResultT] = []
    with ProcessPoolExecutor(jobs) as pool:
        for number, part in enumerate(pool.map(work, cases), start=1):
            results += part
            if number % REPORT_EVERY == 0 or number == len(cases):
                print(f"{number} of {len(cases)} drives", file=sys.stderr, flush=True)
    return results


def percent(share: float) -> str:
    """Return a share 0..1 as whole percent."""
    return f"{100.0 * share:.0f}"


def root_mean_square(values: npt.NDArray[np.float64]) -> float:
    """Return the RMS of some values."""
    return float(np.sqrt(np.mean(np.square(values))))
