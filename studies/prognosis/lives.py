"""Simulated lives of clutches: what truly becomes of them, and the results that a service would have had.

Results have the errors that ``studies.prognosis.error_model`` finds of the real estimator, and some that it does not
find. Of some thirty results one is drawn.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from diag_service.diagnosis.condition.verdict import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO
from diag_service.diagnosis.prognosis import History
from studies.prognosis.truth import ALL_TYPES, KM_PER_YEAR, REFERENCE, Fleet, Lived, Plan, Stratum, Truth, lived_of

DRIVEN_KM: Final = 150_000.0  # as far as results go
COLD_DEGC: Final = (25.0, 60.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """What is wrong with results: standard deviations, of mu_C and mu_S where there are two."""

    row_km: float = 10.0  # from result to result, the mean
    stated: tuple[float, float] = (0.017, 0.036)  # of one shift alone
    worse: tuple[float, float] = (0.7, 1.4)  # true over stated deviation, by vehicle
    correlation: float = 0.0
    drive_km: float = 15.0
    drive: tuple[float, float] = (0.005, 0.008)  # that all results of one drive share
    drive_correlation: float = 0.3
    scale: float = 0.03  # common to all results: gain and area
    split_new: float = 0.007  # what mu_S has of its own in new fluid
    split_gone: float = 0.0045  # and when no margin is left


ERRORS: Final = Errors()


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """One simulated clutch: what was measured, and what was true."""

    seed: int
    stratum: StrEnum
    history: History
    begin_km: float  # odometer at the last fill, where the fluid's life begins
    watch_km: float  # odometer at which its truth passes the limits
    change_km: float
    forgotten_km: float | None  # odometer of a fill that nobody noted
    truth: Truth

    @property
    def life_km(self) -> float:
        """How long the last fluid truly lasts."""
        return self.change_km - self.begin_km

    def rows_until(self, odometer_km: float) -> int:
        """Return how many results there are up to an odometer."""
        return int(np.searchsorted(self.history.odometer_m, odometer_km * 1000.0, side="right"))


def life_of(seed: int, errors: Errors = ERRORS, fleet: Fleet = ALL_TYPES) -> Life:
    """Return the life of a seed; strata come in turn."""
    return life_from(seed, lived_of(seed, fleet), errors)


def life_from(seed: int, lived: Lived, errors: Errors) -> Life:
    """Return what was measured of what became of a clutch."""
    is_noted = lived.stratum is not Stratum.FORGOTTEN_FILL
    history, noise_ratio = _measured(lived, errors)
    return Life(
        seed=seed,
        stratum=lived.stratum,
        history=_with_fill(history, lived.begin_km) if is_noted and lived.begin_km else history,
        begin_km=lived.begin_km,
        watch_km=lived.first_below_km(WATCH_MARGIN_RATIO, WATCH_LEVEL_RATIO),
        change_km=lived.first_below_km(0.0, CHANGE_LEVEL_RATIO),
        forgotten_km=None if is_noted else lived.begin_km,
        truth=replace(lived.truth, noise_ratio=noise_ratio),
    )


def life_km_of(seed: int) -> float:
    """Return how long the last fluid of a life truly lasts; no results are drawn."""
    lived = lived_of(seed)
    return lived.first_below_km(0.0, CHANGE_LEVEL_RATIO) - lived.begin_km


def _measured(lived: Lived, errors: Errors) -> tuple[History, float]:
    """Return the results of a life, by single shifts' errors, and how much larger those are than stated."""
    rng, truth = lived.rng, lived.truth
    odometer_km = np.cumsum(rng.gamma(0.5, 2.0 * errors.row_km, int(DRIVEN_KM / errors.row_km)))
    odometer_km = odometer_km[odometer_km < DRIVEN_KM]
    if lived.stratum is Stratum.GAPS:
        odometer_km = odometer_km[_is_kept(rng, odometer_km)]
    count = len(odometer_km)
    degc, is_cold = _oil(rng, lived.plan, odometer_km)
    stated = np.outer(errors.stated, np.where(is_cold, 2.0, 1.0)) * rng.uniform(0.8, 1.25, (2, count))
    worse = float(rng.uniform(*errors.worse))
    noise = stated * worse * _pairs(rng, errors.correlation, count) * np.where(rng.random(count) < 0.005, 6.0, 1.0)
    place = np.searchsorted(truth.road_km, odometer_km, side="right") - 1  # a fill is a step
    true = np.array([truth.mu_c[place], truth.mu_s[place]])
    warm = 1.0 + np.outer(rng.normal(-2.0e-4, 3.0e-4, 2), degc - 80.0)
    shared = _shared(rng, errors, odometer_km, _gone(true)) + _drift(rng, lived.stratum, odometer_km)
    mu_c, mu_s = true * (1.0 + shared) * warm * (1.0 + noise)
    energy_j = rng.lognormal(np.log(8.0e3), 0.5, count) * np.interp(odometer_km, truth.road_km, lived.load)
    common_s = float(np.hypot(errors.scale, errors.split_gone))
    history = History(
        end_s=odometer_km / KM_PER_YEAR * 3.15e7,
        odometer_m=odometer_km * 1000.0,
        mu_c=mu_c,
        mu_s=mu_s,
        random_std_mu_c=stated[0] * REFERENCE.mu_c,
        random_std_mu_s=stated[1] * REFERENCE.mu_s,
        random_correlation=np.full(count, errors.correlation),
        common_std_mu_c=np.full(count, errors.scale * REFERENCE.mu_c),
        common_std_mu_s=np.full(count, common_s * REFERENCE.mu_s),
        common_correlation=np.full(count, errors.scale / common_s),
        sump_temperature_k=degc + 273.15,
        slip_energy_j=energy_j,
        event_count=np.ones(count),
        fluid_number=np.zeros(count, np.int64),
        new_fluids=(0,),
    )
    return history, worse


def _pairs(rng: np.random.Generator, correlation: float, count: int) -> FloatArray:
    """Return standard normal pairs, shape (2, count)."""
    one, other = rng.standard_normal((2, count))
    return np.array([one, correlation * one + np.sqrt(1.0 - correlation**2) * other])


def _gone(true: FloatArray) -> FloatArray:
    """Return which part of new fluid's margin is gone."""
    return np.asarray(1.0 - (true[0] - true[1]) / (REFERENCE.mu_c - REFERENCE.mu_s))


def _shared(rng: np.random.Generator, errors: Errors, odometer_km: FloatArray, gone: FloatArray) -> FloatArray:
    """Return the relative errors that a vehicle's results share, and those of one drive, shape (2, n)."""
    scale, split_new, split_gone = rng.normal(0.0, (errors.scale, errors.split_new, errors.split_gone))
    drive = (odometer_km / errors.drive_km).astype(np.int64)
    of_drive = np.array(errors.drive)[:, None] * _pairs(rng, errors.drive_correlation, int(drive.max()) + 1)[:, drive]
    return np.array([np.full_like(gone, scale), scale + split_new * (1.0 - gone) + split_gone * gone]) + of_drive


def _oil(rng: np.random.Generator, plan: Plan, odometer_km: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the oil temperature of each result, by season and warming up, and which of them are cold."""
    is_cold = rng.random(len(odometer_km)) < 0.1
    season_k = plan.season_k * np.sin(2.0 * np.pi * (odometer_km / KM_PER_YEAR + plan.winter))
    warm = 85.0 + season_k + rng.normal(0.0, 6.0, len(odometer_km))
    return np.where(is_cold, rng.uniform(*COLD_DEGC, len(odometer_km)), warm), is_cold


def _drift(rng: np.random.Generator, stratum: StrEnum, odometer_km: FloatArray) -> FloatArray:
    """Return by which growing share mu_C and mu_S are read too high: a torque that drifts, a pressure beside it."""
    if stratum is not Stratum.DRIFT:
        return np.zeros((2, len(odometer_km)))
    both, apart = rng.normal(0.0, 0.02), rng.normal(0.0, 0.008)
    return np.outer((both, both + apart), odometer_km / 100_000.0)


def _is_kept(rng: np.random.Generator, odometer_km: FloatArray) -> BoolArray:
    """Return which results are there on a vehicle that is not heard of for long stretches."""
    is_kept = rng.random(len(odometer_km)) < 0.7
    for _ in range(3):
        start_km = rng.uniform(0.0, 0.7 * DRIVEN_KM)
        is_kept &= (odometer_km < start_km) | (odometer_km > start_km + rng.uniform(5_000.0, 20_000.0))
    return np.asarray(is_kept)


def _with_fill(history: History, fill_km: float) -> History:
    number = (history.odometer_m >= fill_km * 1000.0).astype(np.int64)
    return replace(history, fluid_number=number, new_fluids=(0, 1))
