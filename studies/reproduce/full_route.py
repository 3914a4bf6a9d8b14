"""The project's own estimator on the paper's sensor sets: full information about every drive."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from studies.full_estimator import FullSignals, estimate_drive, nominal_vehicle
from studies.reproduce.bound import bounds_percent
from studies.reproduce.drives import (
    CYCLE_COUNT,
    PERIOD_S,
    PRESSURE_NOISE_RATIO,
    SPEED_NOISE_RATIO,
    Case,
    PaperDrive,
    drive,
    noisy,
    rms,
)
from studies.reproduce.study import CALIBRATION, CLUTCHES, DRIVELINE, PARAMETERS, Key, true_value
from canlog.arrays import FloatArray
from clutch_model.calibration import clutch_of_gear
from ecu_emulator.plant import Col

PROCESS_COUNT = min(2, os.cpu_count() or 1)
WITHIN_STD = 2.0
VEHICLE = nominal_vehicle()


@dataclass(frozen=True, slots=True)
class Job:
    """One drive and one draw of the noise; without a draw the readings are exact, and not known to be."""

    case: Case
    drive_seed: int
    noise_seed: int | None
    cycles: int = CYCLE_COUNT


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """One parameter after one drive, percent of the true value; NaN where the estimator found nothing."""

    key: Key
    error: float
    std: float  # as stated
    random_std: float  # as stated, without the floor
    bound: float
    is_slope_right: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """One parameter over many runs, percent of the true value."""

    count: int
    mean: float
    rms: float
    worst: float
    std: float  # mean of those stated
    random_std: float
    coverage: float  # share of the runs within two stated standard deviations
    random_coverage: float  # likewise, without the floor
    bound_ratio: float  # root mean square of error over bound
    slope_right: float


def full_signals(driven: PaperDrive, noise_seed: int | None) -> FullSignals:
    """Return the sensor set with the gears that the shift control engaged."""
    clean = driven.signals
    read = clean if noise_seed is None else noisy(clean, noise_seed)
    current, preselected = (
        driven.rows[:, column].astype(np.int64) for column in (Col.CURRENT_GEAR, Col.PRESELECTED_GEAR)
    )
    on_first = clutch_of_gear(current) == 1
    return FullSignals(
        period_s=PERIOD_S,
        hub_rad_s=read.hub_rad_s,
        input_rad_s=read.input_rad_s,
        pressure_pa=read.pressure_pa,
        flywheel_nm=clean.flywheel_nm,
        shaft_nm=clean.shaft_nm,
        oil_k=clean.oil_k,
        gears=np.stack((np.where(on_first, current, preselected), np.where(on_first, preselected, current))),
        speed_std_rad_s=SPEED_NOISE_RATIO * np.array([rms(one) for one in (clean.hub_rad_s, *clean.input_rad_s)]),
        pressure_std_pa=PRESSURE_NOISE_RATIO * np.array([rms(one) for one in clean.pressure_pa]),
    )


def run(job: Job) -> list[Found]:
    """Drive, estimate, and compare with the truth."""
    driven, bounds = _driven(job.case, job.drive_seed, job.cycles)
    analysis = estimate_drive(full_signals(driven, job.noise_seed), CALIBRATION, DRIVELINE, VEHICLE)
    found = []
    for clutch, estimate in zip(CLUTCHES, analysis.estimates, strict=True):
        rises = true_value(driven, clutch, "mu_c") > true_value(driven, clutch, "mu_s")
        for parameter in PARAMETERS:
            key, true = (job.case, clutch, parameter), true_value(driven, clutch, parameter)
            value, std, random_std = (
                float("nan") if estimate is None else float(getattr(estimate, name))
                for name in (parameter, f"std_{parameter}", f"random_std_{parameter}")
            )
            found.append(
                Found(
                    key=key,
                    error=100.0 * (value / true - 1.0),
                    std=100.0 * std / true,
                    random_std=100.0 * random_std / true,
                    bound=bounds[key],
                    is_slope_right=estimate is not None and (estimate.mu_c > estimate.mu_s) == rises,
                )
            )
    return found


def run_all(jobs: Sequence[Job], advance: Callable[[], None]) -> list[Found]:
    """Run jobs in a few processes; ``advance`` hears of every one."""
    found: list[Found] = []
    with ProcessPoolExecutor(PROCESS_COUNT) as pool:
        for future in as_completed([pool.submit(run, job) for job in jobs]):
            found += future.result()
            advance()
    return found


def figures(found: Iterable[Found]) -> Mapping[Key, Figures]:
    """Return what the runs come to, by parameter."""
    by_key: dict[Key, list[Found]] = {}
    for one in found:
        by_key.setdefault(one.key, []).append(one)
    return {key: _figures(runs) for key, runs in by_key.items()}


def _figures(runs: Sequence[Found]) -> Figures:
    def column(name: str) -> FloatArray:
        return np.array([getattr(one, name) for one in runs], dtype=np.float64)

    error = column("error")
    return Figures(
        count=len(runs),
        mean=float(np.mean(error)),
        rms=rms(error),
        worst=float(np.max(np.abs(error))),
        std=float(np.mean(column("std"))),
        random_std=float(np.mean(column("random_std"))),
        coverage=float(np.mean(np.abs(error) <= WITHIN_STD * column("std"))),
        random_coverage=float(np.mean(np.abs(error) <= WITHIN_STD * column("random_std"))),
        bound_ratio=rms(error / column("bound")),
        slope_right=float(np.mean(column("is_slope_right"))),
    )


@lru_cache(maxsize=1)
def _driven(case: Case, seed: int, cycles: int) -> tuple[PaperDrive, Mapping[Key, float]]:
    driven = drive(case, cycles=cycles, seed=seed)
    return driven, bounds_percent(driven)
