"""Simulated lives of clutches: what truly becomes of them, and the results that a service would have had.

Nothing here is from the prognosis: fluids age by a power of the work done, faster in heat, with bends. Of some thirty
results one is drawn.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO
from clutch_results.prognosis import History

REFERENCE: Final = nominal_calibration().clutches[0].friction
STEP_KM: Final = 100.0  # of the true life
TRUTH_KM: Final = 450_000.0  # as far as truth is known
KM_PER_YEAR: Final = 15_000.0
USUAL_KM: Final = 80_000.0  # median life of fluid
LIFE_LOG_STD: Final = 0.35
STREAM: Final = 56
NEXT_LOG_STD: Final = 0.15  # one vehicle's fluids among each other
SHAPES: Final = (0.85, 1.2)  # power of the ageing
LINING_PER_KM: Final = {False: (0.0, 1.5e-7), True: (3.0e-7, 6.0e-7)}  # by whether its batch is bad
CASE_2: Final = 0.15  # by which aged fluid lowers mu_C and raises mu_S: scenario case2
GONE: Final = 1.0 / (CASE_2 * (REFERENCE.mu_c + REFERENCE.mu_s) / (REFERENCE.mu_c - REFERENCE.mu_s))  # of case 2
DRIVEN_KM: Final = 150_000.0  # as far as results go
COLD_DEGC: Final = (25.0, 60.0)
# What is wrong with results, as whole simulated drives of ageing fluid showed: deviations, of mu_C and mu_S if two.
ROW_KM: Final = 10.0  # from result to result, the mean
STATED: Final = (0.017, 0.036)  # of one shift alone
WORSE: Final = (0.7, 1.4)  # true over stated deviation, by vehicle
PER_DRIVE_KM: Final = 15.0
PER_DRIVE: Final = (0.005, 0.008)  # that all results of one drive share
DRIVE_CORRELATION: Final = 0.3
SCALE: Final = 0.03  # common to all results: gain and area
SPLIT_NEW: Final = 0.007  # what mu_S has of its own in new fluid
SPLIT_GONE: Final = 0.0045  # and when no margin is left


class Stratum(StrEnum):
    """What is special about a life; heat, seasons, cold starts, outliers and scatter are in all."""

    STEADY = "steady"
    KNEE = "knee"
    RUN_IN = "run-in"
    LOAD = "load change"
    SEASON = "hot and cold seasons"
    KNOWN_FILL = "fluid change, noted"
    FORGOTTEN_FILL = "fluid change, forgotten"
    GAPS = "missing data"
    DRIFT = "drifting sensor"
    BAD_LINING = "bad lining batch"


STRATA: Final = tuple(Stratum)  # of the seeds, in turn


@dataclass(frozen=True, slots=True, kw_only=True)
class LifeTruth:
    """Friction along the road."""

    road_km: FloatArray  # (r,)
    mu_c: FloatArray
    mu_s: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class LifePlan:
    """What is drawn of one life before it is lived."""

    life_km: tuple[float, float]  # of the first and the second fluid, at usual work
    shape: float  # power of the ageing
    fill_km: float  # infinite: never
    knee: tuple[float, float]  # where, as a share of the last fluid's life, and by which factor
    load: tuple[float, float]  # odometer of a change, and its factor
    season_k: float
    winter: float  # part of a year at odometer zero
    lining_per_km: float
    run_in: tuple[float, float]  # size in mu_C, and distance [km]


@dataclass(frozen=True, slots=True, kw_only=True)
class Lived:
    """What truly became of a clutch."""

    rng: np.random.Generator  # as the truth left it
    stratum: StrEnum
    plan: LifePlan
    load: FloatArray
    truth: LifeTruth

    @property
    def begin_km(self) -> float:
        """Odometer at the last fill."""
        return self.plan.fill_km if np.isfinite(self.plan.fill_km) else 0.0

    def first_below_km(self, margin_ratio: float, level_ratio: float) -> float:
        """Return the odometer from which on the last fluid is below a limit, or the end of what is known."""
        truth = self.truth
        margin = (truth.mu_c - truth.mu_s) / (REFERENCE.mu_c - REFERENCE.mu_s)
        level = truth.mu_c / REFERENCE.mu_c
        own = level / level[np.searchsorted(truth.road_km, self.begin_km)]
        is_below = (margin < margin_ratio) | (np.minimum(level, own) < level_ratio)
        rows = np.flatnonzero(is_below & (truth.road_km >= self.begin_km))
        return float(truth.road_km[rows[0]]) if len(rows) else TRUTH_KM


def lived_of(seed: int) -> Lived:
    stratum = STRATA[seed % len(STRATA)]
    rng = np.random.default_rng([seed, STREAM])
    plan = _planned(rng, stratum)
    road_km = np.arange(0.0, TRUTH_KM, STEP_KM)
    load = np.where(road_km < plan.load[0], 1.0, plan.load[1])
    return Lived(rng=rng, stratum=stratum, plan=plan, load=load, truth=_truth(rng, plan, road_km, load, stratum))


def _planned(rng: np.random.Generator, stratum: Stratum) -> LifePlan:
    life_km = float(np.clip(rng.lognormal(np.log(USUAL_KM), LIFE_LOG_STD), 0.375 * USUAL_KM, 2.25 * USUAL_KM))
    has_fill = stratum in {Stratum.KNOWN_FILL, Stratum.FORGOTTEN_FILL}
    has_knee, has_run_in = stratum is Stratum.KNEE, stratum is Stratum.RUN_IN
    load_km = rng.uniform(0.2, 0.8) * life_km if stratum is Stratum.LOAD else np.inf
    return LifePlan(
        life_km=(life_km, life_km * float(rng.lognormal(0.0, NEXT_LOG_STD))),
        shape=float(rng.uniform(*SHAPES)),
        fill_km=_on_grid(np.clip(rng.uniform(0.5, 0.85) * life_km, 20_000.0, 70_000.0)) if has_fill else np.inf,
        knee=(float(rng.uniform(0.2, 0.6)), float(rng.uniform(1.5, 3.0))) if has_knee else (1.0, 1.0),
        load=(float(load_km), float(rng.choice([rng.uniform(0.5, 0.75), rng.uniform(1.4, 2.2)]))),
        season_k=float(rng.uniform(14.0, 20.0) if stratum is Stratum.SEASON else rng.uniform(4.0, 9.0)),
        winter=float(rng.uniform()),
        lining_per_km=float(rng.uniform(*LINING_PER_KM[stratum is Stratum.BAD_LINING])),
        run_in=(float(rng.normal(0.0, 0.015)), float(rng.uniform(2_000.0, 6_000.0))) if has_run_in else (0.0, 1.0),
    )


def _truth(
    rng: np.random.Generator, plan: LifePlan, road_km: FloatArray, load: FloatArray, stratum: Stratum
) -> LifeTruth:
    """Return what truly becomes of a clutch along the road, friction at the reference temperature."""
    years = road_km / KM_PER_YEAR + plan.winter
    heat = np.exp(plan.season_k / 60.0 * np.sin(2.0 * np.pi * years))  # fluid ages twice as fast 40 K hotter
    is_second = road_km >= plan.fill_km
    usual_km = np.where(is_second, plan.life_km[1], plan.life_km[0])
    last_km = plan.life_km[1] if np.isfinite(plan.fill_km) else plan.life_km[0]
    knee_km = (plan.fill_km if np.isfinite(plan.fill_km) else 0.0) + plan.knee[0] * last_km
    pace = heat * load * np.where(road_km < knee_km, 1.0, plan.knee[1])
    work = np.cumsum(pace * STEP_KM / usual_km)
    work -= np.where(is_second, work[np.argmax(is_second)], 0.0)
    damage = GONE * np.maximum(work, 0.0) ** plan.shape
    is_bad = stratum is Stratum.BAD_LINING
    new_c = REFERENCE.mu_c * (1.0 + rng.normal(0.0, 0.01) - (0.04 if is_bad else 0.0))
    new_s = REFERENCE.mu_s * (1.0 + rng.normal(0.0, 0.01) - (0.04 if is_bad else 0.0))
    lining = plan.lining_per_km * np.cumsum(load) * STEP_KM
    run_in = plan.run_in[0] * (np.exp(-road_km / plan.run_in[1]) - 1.0)
    share = float(rng.uniform(0.8, 1.2))  # how the margin's loss is shared by the two coefficients
    mu_c = new_c * (1.0 - CASE_2 * share * damage - lining + run_in)
    mu_s = new_s * (1.0 + CASE_2 * (2.0 - share) * damage - lining)
    return LifeTruth(road_km=road_km, mu_c=mu_c, mu_s=mu_s)


def _on_grid(odometer_km: float) -> float:
    """Return the next odometer at which the truth is known."""
    return float(np.ceil(odometer_km / STEP_KM) * STEP_KM)


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

    @property
    def life_km(self) -> float:
        """How long the last fluid truly lasts."""
        return self.change_km - self.begin_km

    def rows_until(self, odometer_km: float) -> int:
        """Return how many results there are up to an odometer."""
        return int(np.searchsorted(self.history.odometer_m, odometer_km * 1000.0, side="right"))


def life_of(seed: int) -> Life:
    """Return the life of a seed; strata come in turn."""
    lived = lived_of(seed)
    is_noted = lived.stratum is not Stratum.FORGOTTEN_FILL
    history = _measured(lived)
    return Life(
        seed=seed,
        stratum=lived.stratum,
        history=_with_fill(history, lived.begin_km) if is_noted and lived.begin_km else history,
        begin_km=lived.begin_km,
        watch_km=lived.first_below_km(WATCH_MARGIN_RATIO, WATCH_LEVEL_RATIO),
        change_km=lived.first_below_km(0.0, CHANGE_LEVEL_RATIO),
        forgotten_km=None if is_noted else lived.begin_km,
    )


def life_km_of(seed: int) -> float:
    """Return how long the last fluid of a life truly lasts; no results are drawn."""
    lived = lived_of(seed)
    return lived.first_below_km(0.0, CHANGE_LEVEL_RATIO) - lived.begin_km


def _measured(lived: Lived) -> History:
    """Return the results of a life, by single shifts' errors."""
    rng, truth = lived.rng, lived.truth
    odometer_km = np.cumsum(rng.gamma(0.5, 2.0 * ROW_KM, int(DRIVEN_KM / ROW_KM)))
    odometer_km = odometer_km[odometer_km < DRIVEN_KM]
    if lived.stratum is Stratum.GAPS:
        odometer_km = odometer_km[_is_kept(rng, odometer_km)]
    count = len(odometer_km)
    degc, is_cold = _oil(rng, lived.plan, odometer_km)
    stated = np.outer(STATED, np.where(is_cold, 2.0, 1.0)) * rng.uniform(0.8, 1.25, (2, count))
    worse = float(rng.uniform(*WORSE))
    noise = stated * worse * _pairs(rng, 0.0, count) * np.where(rng.random(count) < 0.005, 6.0, 1.0)
    place = np.searchsorted(truth.road_km, odometer_km, side="right") - 1  # a fill is a step
    true = np.array([truth.mu_c[place], truth.mu_s[place]])
    warm = 1.0 + np.outer(rng.normal(-2.0e-4, 3.0e-4, 2), degc - 80.0)
    shared = _shared(rng, odometer_km, _gone(true)) + _drift(rng, lived.stratum, odometer_km)
    mu_c, mu_s = true * (1.0 + shared) * warm * (1.0 + noise)
    energy_j = rng.lognormal(np.log(8.0e3), 0.5, count) * np.interp(odometer_km, truth.road_km, lived.load)
    common_s = float(np.hypot(SCALE, SPLIT_GONE))
    return History(
        end_s=odometer_km / KM_PER_YEAR * 3.15e7,
        odometer_m=odometer_km * 1000.0,
        mu_c=mu_c,
        mu_s=mu_s,
        random_std_mu_c=stated[0] * REFERENCE.mu_c,
        random_std_mu_s=stated[1] * REFERENCE.mu_s,
        random_correlation=np.full(count, 0.0),
        common_std_mu_c=np.full(count, SCALE * REFERENCE.mu_c),
        common_std_mu_s=np.full(count, common_s * REFERENCE.mu_s),
        common_correlation=np.full(count, SCALE / common_s),
        sump_temperature_k=degc + 273.15,
        slip_energy_j=energy_j,
        fluid_number=np.zeros(count, np.int64),
        new_fluids=(0,),
    )


def _pairs(rng: np.random.Generator, correlation: float, count: int) -> FloatArray:
    """Return standard normal pairs, shape (2, count)."""
    one, other = rng.standard_normal((2, count))
    return np.array([one, correlation * one + np.sqrt(1.0 - correlation**2) * other])


def _gone(true: FloatArray) -> FloatArray:
    """Return which part of new fluid's margin is gone."""
    return np.asarray(1.0 - (true[0] - true[1]) / (REFERENCE.mu_c - REFERENCE.mu_s))


def _shared(rng: np.random.Generator, odometer_km: FloatArray, gone: FloatArray) -> FloatArray:
    """Return the relative errors that a vehicle's results share, and those of one drive, shape (2, n)."""
    scale, split_new, split_gone = rng.normal(0.0, (SCALE, SPLIT_NEW, SPLIT_GONE))
    drive = (odometer_km / PER_DRIVE_KM).astype(np.int64)
    of_drive = np.array(PER_DRIVE)[:, None] * _pairs(rng, DRIVE_CORRELATION, int(drive.max()) + 1)[:, drive]
    return np.array([np.full_like(gone, scale), scale + split_new * (1.0 - gone) + split_gone * gone]) + of_drive


def _oil(rng: np.random.Generator, plan: LifePlan, odometer_km: FloatArray) -> tuple[FloatArray, BoolArray]:
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
