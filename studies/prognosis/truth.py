"""What truly becomes of simulated clutches: margin and level along the road, kinds of lives, limits.

Nothing here is from the prognosis: fluids age by a power of the work done, faster in heat, with bends.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration

REFERENCE: Final = nominal_calibration().clutches[0].friction
STEP_KM: Final = 100.0  # of the true life
TRUTH_KM: Final = 450_000.0  # as far as truth is known
KM_PER_YEAR: Final = 15_000.0
NEXT_LOG_STD: Final = 0.15  # one vehicle's fluids among each other
SHAPES: Final = (0.85, 1.2)  # power of the ageing
LINING_PER_KM: Final = {False: (0.0, 1.5e-7), True: (3.0e-7, 6.0e-7)}  # by whether its batch is bad
CASE_2: Final = 0.15  # by which aged fluid lowers mu_C and raises mu_S, docs/model.md
GONE: Final = 1.0 / (CASE_2 * (REFERENCE.mu_c + REFERENCE.mu_s) / (REFERENCE.mu_c - REFERENCE.mu_s))  # of case 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """Which vehicles are drawn."""

    usual_km: float = 80_000.0  # median life of fluid
    life_log_std: float = 0.35
    stream: int = 56  # another one: other lives by the same seeds


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


ALL_TYPES: Final = Fleet()
STRATA: Final = tuple(Stratum)  # of the seeds, in turn


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What an oracle may know of a life beyond its results."""

    road_km: FloatArray  # (r,)
    mu_c: FloatArray
    mu_s: FloatArray
    heat: FloatArray  # ageing over that at the mean temperature
    pace: FloatArray  # ageing over that at usual work: heat, load and bends
    life_km: float  # of the last fluid, at usual work
    expected_km: float  # what the population or, of a second fluid, the first one let expect of it
    life_log_std: float
    run_in: FloatArray  # part of mu_C
    lining_km: FloatArray  # that the lining wears by
    noise_ratio: float  # random errors over stated ones


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
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
    plan: Plan
    load: FloatArray
    truth: Truth

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


def lived_of(seed: int, fleet: Fleet = ALL_TYPES) -> Lived:
    stratum = STRATA[seed % len(STRATA)]
    rng = np.random.default_rng([seed, fleet.stream])
    plan = _planned(rng, stratum, fleet)
    road_km = np.arange(0.0, TRUTH_KM, STEP_KM)
    load = np.where(road_km < plan.load[0], 1.0, plan.load[1])
    return Lived(rng=rng, stratum=stratum, plan=plan, load=load, truth=_truth(rng, plan, road_km, load, stratum, fleet))


def _planned(rng: np.random.Generator, stratum: Stratum, fleet: Fleet) -> Plan:
    drawn_km = rng.lognormal(np.log(fleet.usual_km), fleet.life_log_std)
    life_km = float(np.clip(drawn_km, 0.375 * fleet.usual_km, 2.25 * fleet.usual_km))
    has_fill = stratum in {Stratum.KNOWN_FILL, Stratum.FORGOTTEN_FILL}
    has_knee, has_run_in = stratum is Stratum.KNEE, stratum is Stratum.RUN_IN
    load_km = rng.uniform(0.2, 0.8) * life_km if stratum is Stratum.LOAD else np.inf
    return Plan(
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
    rng: np.random.Generator, plan: Plan, road_km: FloatArray, load: FloatArray, stratum: Stratum, fleet: Fleet
) -> Truth:
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
    has_fill = bool(np.isfinite(plan.fill_km))
    return Truth(
        road_km=road_km,
        mu_c=mu_c,
        mu_s=mu_s,
        heat=heat,
        pace=pace,
        life_km=last_km,
        expected_km=plan.life_km[0] if has_fill else fleet.usual_km,
        life_log_std=NEXT_LOG_STD if has_fill else fleet.life_log_std,
        run_in=run_in,
        lining_km=np.cumsum(load) * STEP_KM,
        noise_ratio=1.0,
    )


def _on_grid(odometer_km: float) -> float:
    """Return the next odometer at which the truth is known."""
    return float(np.ceil(odometer_km / STEP_KM) * STEP_KM)
