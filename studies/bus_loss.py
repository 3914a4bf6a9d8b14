"""Shifts on a bus that loses frames at random: what is still accepted, and how far it is from the truth.

Many short drives, each with its own noise and its own lost frames, at no loss, 1 % and 5 %. At 1 % the accepted
estimates should stay within their stated intervals, at 5 % shifts should be rejected rather than wrong.

    python -m studies.bus_loss --seeds 40
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from studies.accuracy import to_batch
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import Status
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.faults import BusFault, BusFaultKind
from ecu_emulator.scenario.scenario_file import load_scenario

SHARES = (0.0, 0.01, 0.05)
SEEDS = 40
FIRST_SEED = 7_000
FAR_STD = 4.0  # beyond it an estimate is wrong, whatever the noise
INTERVALS = {2.0: 0.954, 3.0: 0.997}  # standard deviations, and what share of errors a normal one keeps within them
SLACK_STD = 3.0  # of the number of errors outside, which chance alone allows


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of the shifts of one drive."""

    statuses: Counter[Status]
    errors_std: tuple[float, ...]  # of accepted estimates, in their own standard deviations without common errors


def lossy_drive(share: float, seed: int) -> Outcome:
    """Drive ten shifts on a bus that loses this share of its frames."""
    loss = BusFault(kind=BusFaultKind.LOSS, share=share) if share else None
    faults = () if loss is None else (loss,)
    frames, truth = frames_of(replace(load_scenario("noise_only"), seed=seed, bus_faults=faults))
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())
    diagnoses = stages.feed(to_batch(frames))
    errors: list[float] = []
    for diagnosis, shift in zip(diagnoses, truth.shifts, strict=True):
        friction = diagnosis.estimate.friction
        if friction is not None:
            errors.append((friction.mu_c - shift.mu_c) / friction.random_std_mu_c)
            errors.append((friction.mu_s - shift.mu_s) / friction.random_std_mu_s)
    return Outcome(statuses=Counter(diagnosis.estimate.status for diagnosis in diagnoses), errors_std=tuple(errors))


def within(errors_std: np.ndarray[tuple[int], np.dtype[np.float64]], width_std: float) -> float:
    """Return the share of errors within so many standard deviations."""
    return float(np.mean(np.abs(errors_std) <= width_std))


def report(share: float, outcomes: Iterable[Outcome]) -> bool:
    """Print what became of all drives at one loss; return whether that is as it should be."""
    statuses: Counter[Status] = Counter()
    errors: list[float] = []
    for outcome in outcomes:
        statuses.update(outcome.statuses)
        errors += outcome.errors_std
    found = np.array(errors)
    accepted, total = len(errors) // 2, statuses.total()
    print(f"loss {100 * share:.0f} %: {total} shifts, {accepted} accepted, {statuses[Status.REJECTED]} rejected")
    if not accepted:
        return share > SHARES[1]
    is_good = True
    for width_std, promised in INTERVALS.items():
        least = promised - SLACK_STD * float(np.sqrt(promised * (1.0 - promised) / len(found)))
        is_kept = within(found, width_std) >= least
        is_good &= is_kept
        print(
            f"  within {width_std:.0f} std {100 * within(found, width_std):5.1f} % of {len(found)}, "
            f"promised {100 * promised:.1f} %: {'met' if is_kept else 'MISSED'}"
        )
    largest = float(np.abs(found).max())
    print(f"  largest error {largest:.1f} std, RMS {np.sqrt(np.mean(found**2)):.2f} std", end="")
    print(f"; none beyond {FAR_STD:g} std: {'met' if largest < FAR_STD else 'MISSED'}", flush=True)
    return is_good and largest < FAR_STD


def drives(share: float, seeds: Iterable[int], workers: int) -> Iterator[Outcome]:
    """Yield what became of many drives."""
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(partial(lossy_drive, share), seeds)


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"drives of ten shifts (default: {SEEDS})")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    kept = [report(share, drives(share, seeds, options.workers)) for share in SHARES]
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
