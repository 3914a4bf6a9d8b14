"""Lives by other laws than those of `truth`: wear as a random process, faster in heat by Arrhenius, with late knees.

Wear is a gamma process, whose increments are positive, or a Wiener process with drift, which may also recover: the two
that the literature on degradation uses most. Life, course, heat and errors are drawn wider than in `truth`.
"""

from enum import StrEnum
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from studies.prognosis.lives import ERRORS, Errors, Life, life_from, life_of
from studies.prognosis.truth import CASE_2, GONE, KM_PER_YEAR, REFERENCE, STEP_KM, TRUTH_KM, Lived, Plan, Truth

GAS_J_PER_MOL_K: Final = 8.314
ACTIVATION_J_PER_MOL: Final = (45.0e3, 90.0e3)  # oxidation of oils
MEAN_K: Final = 358.15
USUAL_KM: Final = 80_000.0
LIFE_LOG_STD: Final = 0.4
STREAM: Final = 77
MIXED_STREAM: Final = 78
RANDOMNESS: Final = (0.02, 0.06)  # deviation of the wear at the end of a life, as a share of it
FEW_ROWS: Final = Errors(row_km=25.0, worse=(0.6, 1.8), drive=(0.006, 0.010))


class Course(StrEnum):
    """What is special about a life; randomness, heat and seasons are in all."""

    STEADY = "steady"
    GAMMA = "gamma wear"
    WIENER = "Wiener wear"
    LATE_KNEE = "late knee"
    BURSTS = "bursts"
    SLOWING = "slowing wear"
    HASTENING = "hastening wear"
    SEASONS = "warm and cold seasons"
    FILL = "fluid change, noted"


COURSES: Final = tuple(Course)


def wear_life_of(seed: int) -> Life:
    """Return the life of a seed by these laws; courses come in turn."""
    return life_from(seed, wear_lived_of(seed), FEW_ROWS if seed // len(COURSES) % 2 else ERRORS)


def mixed_life_of(seed: int) -> Life:
    """Return the life of a seed by the laws of one or the other simulator, as it falls."""
    rng = np.random.default_rng([seed, MIXED_STREAM])
    number = int(rng.integers(10**9, 2 * 10**9))
    return wear_life_of(number) if rng.random() < 0.5 else life_of(number)


def wear_lived_of(seed: int) -> Lived:
    """Return what truly becomes of a clutch."""
    rng = np.random.default_rng([seed, STREAM])
    course = COURSES[seed % len(COURSES)]
    life_km = float(np.clip(rng.lognormal(np.log(USUAL_KM), LIFE_LOG_STD), 25_000.0, 200_000.0))
    fill_km = float(np.ceil(rng.uniform(0.3, 0.7) * min(life_km, 80_000.0) / STEP_KM) * STEP_KM)
    plan = Plan(
        life_km=(life_km, life_km * float(rng.lognormal(0.0, 0.2))),
        shape=_shape(rng, course),
        fill_km=fill_km if course is Course.FILL else np.inf,
        knee=(float(rng.uniform(0.5, 0.9)), float(rng.uniform(1.5, 4.0))) if course is Course.LATE_KNEE else (9.0, 1.0),
        load=(np.inf, 1.0),
        season_k=float(rng.uniform(10.0, 20.0) if course is Course.SEASONS else rng.uniform(2.0, 8.0)),
        winter=float(rng.uniform()),
        lining_per_km=0.0,
        run_in=(0.0, 1.0),
    )
    road_km = np.arange(0.0, TRUTH_KM, STEP_KM)
    heat = _heat(rng, plan, road_km)
    is_second = road_km >= plan.fill_km
    begin_km = plan.fill_km if np.isfinite(plan.fill_km) else 0.0
    last_km = plan.life_km[1] if np.isfinite(plan.fill_km) else life_km
    pace = heat * np.where(road_km < begin_km + plan.knee[0] * last_km, 1.0, plan.knee[1])
    wear = np.zeros_like(road_km)
    for own, own_km in ((~is_second, life_km), (is_second, plan.life_km[1])):
        if np.any(own):
            clock = np.cumsum(pace[own]) * STEP_KM / own_km  # 1 at the end of a usual life
            wear[own] = _process(rng, course, clock**plan.shape)
    share = float(rng.uniform(0.8, 1.2))
    new_c, new_s = (mu * (1.0 + rng.normal(0.0, 0.01)) for mu in (REFERENCE.mu_c, REFERENCE.mu_s))
    truth = Truth(
        road_km=road_km,
        mu_c=new_c * (1.0 - CASE_2 * share * GONE * wear),
        mu_s=new_s * (1.0 + CASE_2 * (2.0 - share) * GONE * wear),
        heat=heat,
        pace=pace,
        life_km=last_km,
        expected_km=USUAL_KM,
        life_log_std=LIFE_LOG_STD,
        run_in=np.zeros_like(road_km),
        lining_km=np.zeros_like(road_km),
        noise_ratio=1.0,
    )
    return Lived(rng=rng, stratum=course, plan=plan, load=np.ones_like(road_km), truth=truth)


def _shape(rng: np.random.Generator, course: Course) -> float:
    if course is Course.SLOWING:
        return float(rng.uniform(0.45, 0.75))
    if course is Course.HASTENING:
        return float(rng.uniform(1.3, 1.9))
    return float(rng.uniform(0.9, 1.1))


def _heat(rng: np.random.Generator, plan: Plan, road_km: FloatArray) -> FloatArray:
    """Return ageing over that of a mean year."""
    oil_k = MEAN_K + plan.season_k * np.sin(2.0 * np.pi * (road_km / KM_PER_YEAR + plan.winter))
    activation = float(rng.uniform(*ACTIVATION_J_PER_MOL))
    heat = np.exp(activation / GAS_J_PER_MOL_K * (1.0 / MEAN_K - 1.0 / oil_k))
    return np.asarray(heat / np.mean(heat), np.float64)


def _process(rng: np.random.Generator, course: Course, clock: FloatArray) -> FloatArray:
    """Return wear whose mean is its clock."""
    steps = np.diff(clock, prepend=0.0)
    spread = float(rng.uniform(*RANDOMNESS))  # at the end of the life
    if course is Course.WIENER:
        return np.asarray(clock + 2.0 * spread * np.cumsum(np.sqrt(steps) * rng.standard_normal(len(steps))))
    scale = (2.0 * spread if course is Course.GAMMA else spread) ** 2
    wear = np.cumsum(rng.gamma(np.maximum(steps, 1e-12) / scale, scale))
    if course is Course.BURSTS:
        for _ in range(rng.poisson(2.0)):
            wear = wear + float(rng.uniform(0.03, 0.12)) * (clock > rng.uniform(0.0, 1.0))
    return np.asarray(wear, np.float64)
