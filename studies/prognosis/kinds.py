"""Four kinds of lives by plain laws, beside the better of a weighted straight line and a life of the usual length.

Wear is drawn as a course over the life, not by the laws of the prognosis: even, in bursts, even after a fill, or with
a late knee. Length, noise, what is stated of it, distance between results, temperature and starts are drawn widely.
Both rivals are distributions: the line by the doubt of its own fit, the life by how lives are drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from rich.table import Table
from scipy.stats import norm

from canlog.arrays import BoolArray, FloatArray
from clutch_results.prognosis import History, prognose
from studies.prognosis.baselines import PROBABILITIES, crps
from studies.prognosis.lives import KM_PER_YEAR, REFERENCE

USUAL_KM: Final = 85_000.0
LIFE_LOG_STD: Final = 0.4
FARTHEST_KM: Final = 300_000.0
M_PER_KM: Final = 1000.0
MARKS: Final = (0.25, 0.5, 0.75, 0.9)
FOLLOWED_AFTER: Final = 0.05  # of a life after its knee
STREAM: Final = 91
ORACLE_KNEES: Final = (0.1, 0.25)  # share of lives with a knee that an oracle believes in
_ORACLE_BINS: Final = 40
_ORACLE_LIVES: Final = 180
_COURSE: Final = np.linspace(0.0, 1.0, 2001)
_AHEAD_KM: Final = FARTHEST_KM * np.linspace(0.0, 1.0, 2001) ** 2


class LifeKind(StrEnum):
    """How the fluid of a life wears."""

    LINEAR = "linear"
    BURSTS = "bursts"
    FILL = "noted fill"
    LATE_KNEE = "late knee"


KINDS: Final = tuple(LifeKind)


@dataclass(frozen=True, slots=True, kw_only=True)
class KindLife:
    """One simulated clutch: its results, and how long its last fluid truly lasts."""

    kind: LifeKind
    history: History
    begin_km: float
    life_km: float
    knee_share: float  # of the life; 1: there is none

    def until(self, mark: float) -> History:
        """Return the results up to a share of the life."""
        end_m = (self.begin_km + mark * self.life_km) * M_PER_KM
        return self.history.first(int(np.searchsorted(self.history.odometer_m, end_m, side="right")))


def kind_life_of(seed: int) -> KindLife:
    """Return the life of a seed; kinds come in turn."""
    rng = np.random.default_rng([seed, STREAM])
    kind = KINDS[seed % len(KINDS)]
    life_km = float(np.clip(rng.lognormal(np.log(USUAL_KM), LIFE_LOG_STD), 15_000.0, 250_000.0))
    begin_km = float(rng.uniform(0.3, 0.9)) * life_km if kind is LifeKind.FILL else 0.0
    last_km = life_km * float(rng.lognormal(0.0, 0.25)) if kind is LifeKind.FILL else life_km
    course, knee_share = _course(rng, kind)
    step_km = float(np.exp(rng.uniform(np.log(15.0), np.log(250.0))))
    odometer_km = np.cumsum(rng.gamma(rng.uniform(0.3, 3.0), 1.0, int((begin_km + last_km) / step_km) + 100))
    odometer_km *= (begin_km + last_km) / odometer_km[-1]
    is_last = odometer_km >= begin_km
    start = 1.0 + 0.06 * rng.standard_normal(2)
    worn = np.where(is_last, np.interp((odometer_km - begin_km) / last_km, _COURSE, course), odometer_km / life_km)
    margin = np.where(is_last, start[1], start[0]) * (1.0 - worn)
    level = 1.0 + 0.01 * rng.standard_normal() - rng.uniform(0.0, 0.12) * worn
    return KindLife(
        kind=kind,
        history=_measured(rng, odometer_km, margin, level, is_last if begin_km else np.zeros_like(is_last)),
        begin_km=begin_km,
        life_km=last_km,
        knee_share=knee_share,
    )


def _course(rng: np.random.Generator, kind: LifeKind) -> tuple[FloatArray, float]:
    """Return the wear over the life, from 0 to 1, and where its knee is."""
    if kind is LifeKind.LATE_KNEE:
        knee, factor = float(rng.uniform(0.65, 0.88)), float(rng.uniform(2.2, 5.5))
        worn = _COURSE + (factor - 1.0) * np.maximum(_COURSE - knee, 0.0)
        return worn / worn[-1], knee
    if kind is LifeKind.BURSTS:
        count = int(np.exp(rng.uniform(np.log(5.0), np.log(60.0))))
        size, width = rng.gamma(rng.uniform(0.5, 3.0), 1.0, count), rng.uniform(0.001, 0.04, count)
        reach = (_COURSE - rng.uniform(0.0, 1.0, count)[:, None]) / width[:, None]
        jumps = size @ np.clip(reach, 0.0, 1.0)
        even = float(rng.uniform(0.2, 0.9))
        worn = even * _COURSE + (1.0 - even) * jumps / max(jumps[-1], 1e-9)
        return worn / worn[-1], 1.0
    return _COURSE, 1.0


def _measured(
    rng: np.random.Generator, odometer_km: FloatArray, margin: FloatArray, level: FloatArray, is_last: BoolArray
) -> History:
    """Return the results of a life, with what is stated of their errors."""
    count = len(odometer_km)
    ratio = np.exp(rng.uniform(np.log([0.004, 0.008]), np.log([0.025, 0.04])))  # of mu_C and mu_S, one result
    stated = np.outer(ratio, np.ones(count)) * rng.uniform(0.7, 1.4, count)
    is_heavy, shape = rng.random() < 0.5, (2, count)
    errors = rng.standard_t(float(rng.uniform(3.0, 30.0)), shape) if is_heavy else rng.standard_normal(shape)
    noise = stated * float(rng.uniform(0.6, 1.6)) * errors
    warmth_k = rng.uniform(2.0, 14.0) * np.sin(2.0 * np.pi * (odometer_km / KM_PER_YEAR + rng.random()))
    warmth_k = warmth_k + rng.normal(5.0, 7.0, count)
    warm = 1.0 + np.outer(rng.normal(-2.0e-4, 2.5e-4, 2), warmth_k)
    common, split = rng.uniform((0.005, 0.0005), (0.05, 0.005))  # stated: of both coefficients, of mu_S alone
    both, of_s = rng.uniform(0.4, 1.2) * rng.standard_normal(2) * (common, split)
    scale = 1.0 + np.array([both, both + of_s])
    mu_c = REFERENCE.mu_c * level
    true = np.array([mu_c, mu_c - (REFERENCE.mu_c - REFERENCE.mu_s) * margin])
    mu_c, mu_s = true * scale[:, None] * warm * (1.0 + noise)
    common_s = float(np.hypot(common, split))
    return History(
        end_s=odometer_km / KM_PER_YEAR * 3.15e7,
        odometer_m=odometer_km * M_PER_KM,
        mu_c=mu_c,
        mu_s=mu_s,
        random_std_mu_c=stated[0] * REFERENCE.mu_c,
        random_std_mu_s=stated[1] * REFERENCE.mu_s,
        random_correlation=np.zeros(count),
        common_std_mu_c=np.full(count, common * REFERENCE.mu_c),
        common_std_mu_s=np.full(count, common_s * REFERENCE.mu_s),
        common_correlation=np.full(count, common / common_s),
        sump_temperature_k=353.15 + warmth_k,
        slip_energy_j=rng.lognormal(np.log(8.0e3), rng.uniform(0.2, 0.7), count),
        fluid_number=is_last.astype(np.int64),
        new_fluids=(0, 1),
    )


def straight_line(history: History) -> tuple[FloatArray, float]:
    """Return what a weighted straight line foretells, quantiles with the doubt of its own fit, and its number [km]."""
    own = history.fluid_number == history.fluid_number[-1]
    at_km = (history.odometer_m[own] - history.odometer_m[-1]) / M_PER_KM
    margin = (history.mu_c[own] - history.mu_s[own]) / (REFERENCE.mu_c - REFERENCE.mu_s)
    warmth_k = history.sump_temperature_k[own] - 353.15
    weight = 1.0 / np.hypot(history.random_std_mu_c, history.random_std_mu_s)[own]
    design = np.column_stack([np.ones_like(at_km), at_km, warmth_k]) * weight[:, None]
    found = np.linalg.lstsq(design, margin * weight, rcond=None)[0]
    left = margin * weight - design @ found
    spread = np.linalg.inv(design.T @ design) * float(left @ left) / max(len(at_km) - 3, 1)
    variance = spread[0, 0] + 2.0 * spread[0, 1] * _AHEAD_KM + spread[1, 1] * _AHEAD_KM**2
    passed = np.maximum.accumulate(norm.cdf(-(found[0] + found[1] * _AHEAD_KM) / np.sqrt(np.maximum(variance, 1e-15))))
    number = float(np.clip(-found[0] / found[1], 0.0, FARTHEST_KM)) if found[1] < 0.0 else FARTHEST_KM
    rising = passed + 1e-12 * np.arange(len(passed))
    return np.interp(PROBABILITIES, rising, _AHEAD_KM, left=0.0, right=FARTHEST_KM), number


def usual_life(age_km: float) -> FloatArray:
    """Return what remains to lives of this age as they are drawn, as quantiles [km]."""
    gone = norm.cdf(np.log(age_km / USUAL_KM) / LIFE_LOG_STD)
    life_km = USUAL_KM * np.exp(LIFE_LOG_STD * norm.ppf(gone + (1.0 - gone) * PROBABILITIES))
    return np.asarray(np.maximum(life_km - age_km, 0.0), np.float64)


def kind_oracles(history: History, knees: Sequence[float]) -> list[FloatArray]:
    """Return what who knows how even lives and those with a knee are drawn foretells of a margin, as quantiles [km].

    ``knees`` are the shares of lives with a knee, one for each oracle. Of this life they know nothing but its results.
    """
    own = history.fluid_number == history.fluid_number[-1]
    odometer_km = history.odometer_m[own] / M_PER_KM
    begin_km = odometer_km[0]
    age_km = odometer_km - begin_km
    margin = (history.mu_c[own] - history.mu_s[own]) / (REFERENCE.mu_c - REFERENCE.mu_s)
    noise = float(np.std(np.diff(margin))) / 2.0**0.5
    place = np.minimum((age_km / age_km[-1] * _ORACLE_BINS).astype(int), _ORACLE_BINS - 1)
    count = np.maximum(np.bincount(place, minlength=_ORACLE_BINS), 1e-9)
    means = [np.bincount(place, one, _ORACLE_BINS) / count for one in (age_km, margin, history.sump_temperature_k[own])]
    at_km, value, warmth_k = means[0], means[1], means[2] - 353.15
    weight = count / noise**2
    life_km = np.exp(np.linspace(np.log(0.9 * age_km[-1]), np.log(260_000.0), _ORACLE_LIVES))
    knee, factor = (one.ravel() for one in np.meshgrid(np.linspace(0.66, 0.87, 8), np.linspace(2.4, 5.3, 7)))
    knee, factor = np.append(knee, 1.0), np.append(factor, 1.0)
    share = at_km / life_km[:, None, None]
    bend = factor[:, None] - 1.0
    worn = (share + bend * np.maximum(share - knee[:, None], 0.0)) / (1.0 + bend * (1.0 - knee[:, None]))
    # Start, an error that the results share and temperature are normal: each life has an exact likelihood.
    columns = np.stack((1.0 - worn, np.ones_like(worn), np.broadcast_to(warmth_k, worn.shape)), axis=-1) * np.array(
        [0.06, 0.02, 0.003]
    )
    surprise = value - (1.0 - worn)
    right = np.einsum("lkbi,lkb->lki", columns, weight * surprise)
    normal = np.einsum("lkbi,lkbj->lkij", columns * weight[:, None], columns) + np.eye(3)
    explained = np.einsum("lki,lki->lk", right, np.linalg.solve(normal, right[..., None])[..., 0])
    log_likelihood = 0.5 * (explained - np.sum(weight * surprise**2, axis=-1) - np.linalg.slogdet(normal)[1])
    log_prior = norm.logpdf(np.log(life_km / USUAL_KM), scale=LIFE_LOG_STD)[:, None]
    likelihood = np.exp(log_likelihood + log_prior - np.max(log_likelihood + log_prior))
    left_km = np.maximum(life_km - age_km[-1], 0.0)
    found = []
    for one in knees:
        belief = one * likelihood[:, :-1].mean(axis=1) + (1.0 - one) * likelihood[:, -1]
        passed = (np.cumsum(belief) - 0.5 * belief) / belief.sum()
        found.append(np.asarray(np.interp(PROBABILITIES, passed, left_km), np.float64))
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class KindLook:
    """What was said at one age of a life: errors in km, of the rivals as distributions and as numbers."""

    kind: LifeKind
    mark: float | None  # None: shortly after the knee
    passed: float  # probability that was given to the truth's side
    crps: float
    line: float
    line_number: float
    usual: float
    usual_number: float
    oracles: tuple[float, ...]  # by `ORACLE_KNEES`; empty where there is none


def kind_looks(seed: int) -> list[KindLook]:
    """Return what is said of the life of a seed at some of its ages, and shortly after its knee."""
    life = kind_life_of(seed)
    after = life.knee_share + FOLLOWED_AFTER
    looks = [_look(life, mark, mark) for mark in MARKS] + ([_look(life, after, None)] if after < 1.0 else [])
    return [look for look in looks if look is not None]


def _look(life: KindLife, share: float, mark: float | None) -> KindLook | None:
    history, age_km = life.until(share), share * life.life_km
    change = prognose(1, history, REFERENCE).change_fluid
    if change is None:
        return None
    left_km = np.array([min(life.life_km - age_km, FARTHEST_KM)])
    line, number_km = straight_line(history)
    knees = () if life.kind is LifeKind.BURSTS else (1.0 if life.kind is LifeKind.LATE_KNEE else 0.0, *ORACLE_KNEES)
    oracles = kind_oracles(history, knees) if knees else ()
    forecasts = (change.passage.quantiles_m(PROBABILITIES) / M_PER_KM, line, usual_life(age_km), *oracles)
    ours, of_line, of_usual, *of_oracles = (float(crps(one[None], left_km)[0]) for one in forecasts)
    return KindLook(
        kind=life.kind,
        mark=mark,
        passed=change.passage.within(float(left_km[0]) * M_PER_KM),
        crps=ours,
        line=of_line,
        line_number=abs(number_km - float(left_km[0])),
        usual=of_usual,
        usual_number=abs(max(USUAL_KM - age_km, 0.0) - float(left_km[0])),
        oracles=tuple(of_oracles),
    )


def kinds_table(looks: Sequence[KindLook]) -> Table:
    """Return coverage of two intervals and CRPS beside the rivals, by kind and age, and over all ages of a kind."""
    table = Table(
        "lives", "age", "looks", "inside 90 %", "inside 50 %", "CRPS, km",
        "/ line", "/ its number", "/ usual life", "/ its number", "/ better", "/ better number",
        title="CRPS over that of a weighted straight line and of a usual life, each with its doubt and as a number",
    )  # fmt: skip
    for kind in KINDS:
        own = [look for look in looks if look.kind is kind]
        for mark in MARKS:
            table.add_row(kind.value, f"{100 * mark:.0f} %", *_cells([one for one in own if one.mark == mark]))
        table.add_row(kind.value, "all", *_cells([one for one in own if one.mark is not None]))
        if kind is LifeKind.LATE_KNEE:
            after = [one for one in own if one.mark is None]
            table.add_row(kind.value, f"knee + {100 * FOLLOWED_AFTER:.0f} %", *_cells(after))
    return table


def _cells(looks: Sequence[KindLook]) -> tuple[str, ...]:
    if not looks:
        return ("0", *9 * ("-",))
    passed = np.array([one.passed for one in looks])
    rows = [(one.crps, one.line, one.line_number, one.usual, one.usual_number) for one in looks]
    ours, line, line_number, usual, usual_number = np.mean(rows, axis=0).tolist()
    rivals = (line, line_number, usual, usual_number, min(line, usual), min(line_number, usual_number))
    inside = (float(np.mean(np.abs(passed - 0.5) <= 0.5 * share)) for share in (0.9, 0.5))
    return (
        str(len(looks)),
        *(f"{100 * one:.0f} %" for one in inside),
        f"{ours:,.0f}",
        *(f"{ours / rival:.2f}" for rival in rivals),
    )


def oracles_table(looks: Sequence[KindLook]) -> Table:
    """Return the CRPS of who knows how lives are drawn, over that of the better rival and of the better number."""
    knows = ("kind known", *(f"{100 * one:.0f} % knees" for one in ORACLE_KNEES))
    table = Table("lives", "age", *(f"{name}, / {rival}" for name in knows for rival in ("better", "number")))
    for kind in KINDS:
        for mark in MARKS:
            own = [one for one in looks if one.kind is kind and one.mark == mark and one.oracles]
            if own:
                rivals = np.mean([(one.line, one.usual, one.line_number, one.usual_number) for one in own], axis=0)
                better = (min(rivals[:2]), min(rivals[2:]))
                means = np.mean([one.oracles for one in own], axis=0)
                cells = (f"{mean / rival:.2f}" for mean in means for rival in better)
                table.add_row(kind.value, f"{100 * mark:.0f} %", *cells)
    return table
