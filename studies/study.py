"""What studies over many drives share: the way from a scenario to its diagnoses, processes with progress, percents."""

import argparse
import pickle
import sys
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from studies.accuracy import to_batch
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

CaseT = TypeVar("CaseT", bound=Hashable)
ResultT = TypeVar("ResultT")

REPORT_EVERY = 20  # drives


def diagnose(scenario: Scenario) -> tuple[list[Diagnosis], TruthLog]:
    """Drive a scenario in memory, frames and decoding included, and return what the service makes of its shifts."""
    frames, truth = frames_of(scenario)
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    return stages.feed(to_batch(frames)), truth


def add_pool_options(parser: argparse.ArgumentParser) -> None:
    """Add what :func:`over_drives` takes: how many processes, and the file of a study that goes on."""
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--kept", type=Path, metavar="FILE", help="results are added to it, so that a study that was ended goes on"
    )


def over_drives(
    work: Callable[[CaseT], list[ResultT]], cases: Sequence[CaseT], jobs: int, kept: Path | None = None
) -> list[ResultT]:
    """Return the results of all cases in their order, worked on by ``jobs`` processes; progress goes to stderr.

    With a file each result is added to it at once, and what it has already is not worked on again: a study of hours
    may be ended at any time. Such a file belongs to one state of the code and one set of options.
    """
    known: dict[CaseT, list[ResultT]] = {} if kept is None else read_kept(kept)
    left = [case for case in cases if case not in known]
    with ProcessPoolExecutor(jobs) as pool:
        for number, (case, part) in enumerate(zip(left, pool.map(work, left), strict=True), start=1):
            known[case] = part
            if kept is not None:
                with kept.open("ab") as file:
                    pickle.dump((case, part), file)
            if number % REPORT_EVERY == 0 or number == len(left):
                print(f"{number} of {len(left)} drives", file=sys.stderr, flush=True)
    return [one for case in cases for one in known[case]]


def read_kept(kept: Path) -> dict[CaseT, list[ResultT]]:
    """Return the cases of a file with their results; a record that was being written at the end is cut off."""
    known = dict[CaseT, list[ResultT]]()
    with kept.open("a+b") as file:
        file.seek(0)
        try:
            while True:
                end = file.tell()
                case, part = pickle.load(file)  # noqa: S301 (a file of one's own)
                known[case] = part
        except (EOFError, pickle.UnpicklingError):
            file.truncate(end)
    return known


def percent(share: float) -> str:
    """Return a share 0..1 as whole percent."""
    return f"{100.0 * share:.0f}"


def root_mean_square(values: npt.NDArray[np.float64]) -> float:
    """Return the RMS of some values."""
    return float(np.sqrt(np.mean(np.square(values))))
