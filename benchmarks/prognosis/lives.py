"""Simulated lives of clutches: what truly becomes of margin and level, and the results that a service would have had.

Nothing here is from the prognosis: fluids age by a power of the work done, faster in heat, with bends; results have the
errors that docs/accuracy.md states of single shifts, and some that nobody states. Of forty events one is drawn.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.thresholds import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO
from diag_service.diagnosis.prognosis import History

REFERENCE: Final = nominal_calibration().clutches[0].friction
STEP_KM: Final = 100.0  # of the true life
TRUTH_KM: Final = 450_000.0  # as far as truth is known
DRIVEN_KM: Final = 150_000.0  # as far as results go
KM_PER_YEAR: Final = 15_000.0
ROW_KM: Final = 40.0
CASE_2: Final = 0.15  # by which aged fluid lowers mu_C and raises mu_S, docs/model.md
GONE: Final = 1.0 / (CASE_2 * (REFERENCE.mu_c + REFERENCE.mu_s) / (REFERENCE.mu_c - REFERENCE.mu_s))  # of case 2
STATED_C: Final = 0.017  # of mu_C, one shift alone, random part
STATED_S: Final = 0.038
CORRELATION: Final = 0.3
SCALE_STD: Final = 0.03  # common to all results: gain and area
SPLIT_STD: Final = 0.01  # what mu_S has of its own
COLD_DEGC: Final = (25.0, 60.0)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """One simulated clutch: what was measured, and what was true."""

    seed: int
    stratum: Stratum
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
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
class _Lived:
    """What truly became of a clutch."""

    rng: np.random.Generator  # as the truth left it
    stratum: Stratum
    plan: _Plan
    road_km: FloatArray
    load: FloatArray
    mu_c: FloatArray
    mu_s: FloatArray

    @property
    def begin_km(self) -> float:
        """Odometer at the last fill."""
        return self.plan.fill_km if np.isfinite(self.plan.fill_km) else 0.0

    def first_below_km(self, margin_ratio: float, level_ratio: float) -> float:
        """Return the odometer from which on the last fluid is below a limit, or the end of what is known."""
        margin = (self.mu_c - self.mu_s) / (REFERENCE.mu_c - REFERENCE.mu_s)
        level = self.mu_c / REFERENCE.mu_c
        own = level / level[np.searchsorted(self.road_km, self.begin_km)]
        is_below = (margin < margin_ratio) | (np.minimum(level, own) < level_ratio)
        rows = np.flatnonzero(is_below & (self.road_km >= self.begin_km))
        return float(self.road_km[rows[0]]) if len(rows) else TRUTH_KM


def life_of(seed: int) -> Life:
    """Return the life of a seed; strata come in turn."""
    lived = _lived(seed)
    is_noted = lived.stratum is not Stratum.FORGOTTEN_FILL
    truth = (lived.road_km, lived.mu_c, lived.mu_s)
    history = _measured(lived.rng, lived.plan, lived.stratum, truth, lived.load)
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
    lived = _lived(seed)
    return lived.first_below_km(0.0, CHANGE_LEVEL_RATIO) - lived.begin_km


def _lived(seed: int) -> _Lived:
    strata = tuple(Stratum)
    stratum = strata[seed % len(strata)]
    rng = np.random.default_rng([seed, 56])
    plan = _planned(rng, stratum)
    road_km = np.arange(0.0, TRUTH_KM, STEP_KM)
    load = np.where(road_km < plan.load[0], 1.0, plan.load[1])
    mu_c, mu_s = _truth(rng, plan, road_km, load, stratum)
    return _Lived(rng=rng, stratum=stratum, plan=plan, road_km=road_km, load=load, mu_c=mu_c, mu_s=mu_s)


def _planned(rng: np.random.Generator, stratum: Stratum) -> _Plan:
    life_km = float(np.clip(rng.lognormal(np.log(80_000.0), 0.35), 30_000.0, 180_000.0))
    has_fill = stratum in {Stratum.KNOWN_FILL, Stratum.FORGOTTEN_FILL}
    has_knee, has_run_in = stratum is Stratum.KNEE, stratum is Stratum.RUN_IN
    load_km = rng.uniform(0.2, 0.8) * life_km if stratum is Stratum.LOAD else np.inf
    return _Plan(
        life_km=(life_km, life_km * float(rng.lognormal(0.0, 0.15))),
        shape=float(rng.uniform(0.85, 1.2)),
        fill_km=float(np.clip(rng.uniform(0.5, 0.85) * life_km, 20_000.0, 70_000.0)) if has_fill else np.inf,
        knee=(float(rng.uniform(0.2, 0.6)), float(rng.uniform(1.5, 3.0))) if has_knee else (1.0, 1.0),
        load=(float(load_km), float(rng.choice([rng.uniform(0.5, 0.75), rng.uniform(1.4, 2.2)]))),
        season_k=float(rng.uniform(14.0, 20.0) if stratum is Stratum.SEASON else rng.uniform(4.0, 9.0)),
        winter=float(rng.uniform()),
        lining_per_km=float(rng.uniform(3.0e-7, 6.0e-7) if stratum is Stratum.BAD_LINING else rng.uniform(0.0, 1.5e-7)),
        run_in=(float(rng.normal(0.0, 0.015)), float(rng.uniform(2_000.0, 6_000.0))) if has_run_in else (0.0, 1.0),
    )


def _truth(
    rng: np.random.Generator, plan: _Plan, road_km: FloatArray, load: FloatArray, stratum: Stratum
) -> tuple[FloatArray, FloatArray]:
    """Return the true mu_C and mu_S along the road, at the reference temperature."""
    years = road_km / KM_PER_YEAR + plan.winter
    heat = np.exp(plan.season_k / 60.0 * np.sin(2.0 * np.pi * years))  # fluid ages twice as fast 40 K hotter
    is_second = road_km >= plan.fill_km
    usual_km = np.where(is_second, plan.life_km[1], plan.life_km[0])
    last_km = plan.life_km[1] if np.isfinite(plan.fill_km) else plan.life_km[0]
    knee_km = (plan.fill_km if np.isfinite(plan.fill_km) else 0.0) + plan.knee[0] * last_km
    rate = heat * load * np.where(road_km < knee_km, 1.0, plan.knee[1]) * STEP_KM / usual_km
    work = np.cumsum(rate)
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
    return mu_c, mu_s


def _measured(
    rng: np.random.Generator,
    plan: _Plan,
    stratum: Stratum,
    truth: tuple[FloatArray, FloatArray, FloatArray],
    load: FloatArray,
) -> History:
    """Return the results of a life, by single shifts' errors."""
    road_km, true_c, true_s = truth
    odometer_km = np.cumsum(rng.gamma(0.5, 2.0 * ROW_KM, int(DRIVEN_KM / ROW_KM)))
    odometer_km = odometer_km[odometer_km < DRIVEN_KM]
    if stratum is Stratum.GAPS:
        odometer_km = odometer_km[_is_kept(rng, odometer_km)]
    count = len(odometer_km)
    degc, is_cold = _oil(rng, plan, odometer_km)
    stated_c = STATED_C * np.where(is_cold, 2.0, 1.0) * rng.uniform(0.8, 1.25, count)
    stated_s = STATED_S * np.where(is_cold, 2.0, 1.0) * rng.uniform(0.8, 1.25, count)
    worse = rng.uniform(0.9, 1.4)  # intervals of single shifts are too narrow on some vehicles
    noise = worse * rng.multivariate_normal(np.zeros(2), [[1.0, CORRELATION], [CORRELATION, 1.0]], count)
    noise *= np.where(rng.random(count) < 0.005, 6.0, 1.0)[:, None]
    scale, split = rng.normal(0.0, SCALE_STD), rng.normal(0.0, SPLIT_STD)
    slope_c, slope_s = rng.normal(-2.0e-4, 3.0e-4, 2)
    drift_c, drift_s = _drift(rng, stratum, odometer_km)
    mu_c = np.interp(odometer_km, road_km, true_c) * (1.0 + scale + drift_c) * (1.0 + slope_c * (degc - 80.0))
    mu_s = np.interp(odometer_km, road_km, true_s) * (1.0 + scale + split + drift_s) * (1.0 + slope_s * (degc - 80.0))
    energy_j = rng.lognormal(np.log(8.0e3), 0.5, count) * np.interp(odometer_km, road_km, load)
    return History(
        end_s=odometer_km / KM_PER_YEAR * 3.15e7,
        odometer_m=odometer_km * 1000.0,
        mu_c=mu_c * (1.0 + stated_c * noise[:, 0]),
        mu_s=mu_s * (1.0 + stated_s * noise[:, 1]),
        random_std_mu_c=stated_c * REFERENCE.mu_c,
        random_std_mu_s=stated_s * REFERENCE.mu_s,
        random_correlation=np.full(count, CORRELATION),
        common_std_mu_c=np.full(count, SCALE_STD * REFERENCE.mu_c),
        common_std_mu_s=np.full(count, np.hypot(SCALE_STD, SPLIT_STD) * REFERENCE.mu_s),
        common_correlation=np.full(count, SCALE_STD / np.hypot(SCALE_STD, SPLIT_STD)),
        sump_temperature_k=degc + 273.15,
        slip_energy_j=energy_j,
        event_count=np.ones(count),
        fluid_number=np.zeros(count, np.int64),
        new_fluids=(0,),
    )


def _oil(rng: np.random.Generator, plan: _Plan, odometer_km: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the oil temperature of each result, by season and warming up, and which of them are cold."""
    is_cold = rng.random(len(odometer_km)) < 0.1
    season_k = plan.season_k * np.sin(2.0 * np.pi * (odometer_km / KM_PER_YEAR + plan.winter))
    warm = 85.0 + season_k + rng.normal(0.0, 6.0, len(odometer_km))
    return np.where(is_cold, rng.uniform(*COLD_DEGC, len(odometer_km)), warm), is_cold


def _drift(rng: np.random.Generator, stratum: Stratum, odometer_km: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by which growing share mu_C and mu_S are read too high: a torque that drifts, a pressure beside it."""
    if stratum is not Stratum.DRIFT:
        return np.zeros_like(odometer_km), np.zeros_like(odometer_km)
    both, apart = rng.normal(0.0, 0.02), rng.normal(0.0, 0.008)
    return both * odometer_km / 100_000.0, (both + apart) * odometer_km / 100_000.0


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
