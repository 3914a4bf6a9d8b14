"""How well a life could be foretold by who knows how lives are drawn, but not what is still to come.

The oracle knows the laws of ageing and of errors with all their scatter; of this very life its seasons, its load and
bends so far, and the fill that nobody noted. It does not know how long this fluid lasts at usual work, its power of
ageing, the errors of this vehicle, nor bends and loads to come. What it cannot tell no prognosis can.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from studies.prognosis.lives import ERRORS, Errors, Life
from studies.prognosis.truth import CASE_2, GONE, LINING_PER_KM, REFERENCE, SHAPES, STEP_KM, Stratum
from canlog.arrays import FloatArray
from diag_service.diagnosis.prognosis import Passage
from diag_service.diagnosis.prognosis.channels import DISTANCE_M
from diag_service.diagnosis.prognosis.trend import normal_cdf

LIFE_STEPS: Final = np.linspace(-2.6, 2.6, 41)  # standard deviations of the logarithm of the life
SHAPE_COUNT: Final = 7
BIN_KM: Final = 500.0
FARTHEST_KM: Final = 300_000.0
M_PER_KM: Final = 1000.0
UNKNOWNS: Final = (
    *("new_c", "new_s", "scale", "split_new", "slope_c", "slope_s", "lining", "share"),
    *("drift", "drift_apart", "split_gone"),
)
MARGIN_OF: Final = np.array([REFERENCE.mu_c, -REFERENCE.mu_s]) / (REFERENCE.mu_c - REFERENCE.mu_s)


def oracle(life: Life, odometer_km: float, errors: Errors = ERRORS) -> Passage:
    """Return when the margin will be gone, foretold at an odometer."""
    log_km = np.log(life.truth.expected_km) + life.truth.life_log_std * LIFE_STEPS
    shape, usual_km = (one.ravel() for one in np.meshgrid(np.linspace(*SHAPES, SHAPE_COUNT), np.exp(log_km)))
    log_prior = np.repeat(-0.5 * LIFE_STEPS**2, SHAPE_COUNT)
    work_km = _work_so_far(life, odometer_km)

    def damage(at_km: FloatArray) -> FloatArray:
        return np.asarray(GONE * (work_km(at_km) / usual_km[:, None]) ** shape[:, None])

    bins = _binned(life, odometer_km, errors)
    mean, covariance, log_evidence = _posterior(life, bins, damage(bins.at_km), errors)
    ahead_km = odometer_km + DISTANCE_M / M_PER_KM
    later = damage(ahead_km)
    rows = np.einsum("a,gadp->gdp", MARGIN_OF, _rows(life, ahead_km, later, np.zeros_like(ahead_km)))
    rows[..., [UNKNOWNS.index(name) for name in ("scale", "split_new", "drift", "drift_apart", "split_gone")]] = 0.0
    run_in = np.interp(ahead_km, life.truth.road_km, life.truth.run_in)
    left = 1.0 + MARGIN_OF[0] * run_in + MARGIN_OF[1] * 2.0 * CASE_2 * later + np.einsum("gdp,gp->gd", rows, mean)
    spread = np.sqrt(np.einsum("gdp,gpq,gdq->gd", rows, covariance, rows))
    weight = np.exp(log_prior + log_evidence - np.max(log_prior + log_evidence))
    passed = weight / weight.sum() @ normal_cdf(-left / spread)
    return Passage(distance_m=DISTANCE_M, probability=np.maximum.accumulate(passed))


def without_bends_km(life: Life, odometer_km: float) -> float:
    """Return how far the fluid would truly go from an odometer if neither load nor rate changed any more [km]."""
    truth = life.truth
    begun = np.where(truth.road_km >= life.begin_km, truth.pace, 0.0)
    gone_km = float(np.interp(life.change_km, truth.road_km, np.cumsum(begun) * STEP_KM))
    ahead_km = np.arange(0.0, FARTHEST_KM, STEP_KM)
    return float(np.interp(gone_km, _work_so_far(life, odometer_km)(odometer_km + ahead_km), ahead_km))


def _work_so_far(life: Life, odometer_km: float) -> Callable[[FloatArray], FloatArray]:
    """Return what gives the work on the last fluid at an odometer [km of usual work], later without any bend."""
    truth = life.truth
    now = int(np.searchsorted(truth.road_km, odometer_km, side="right")) - 1
    pace = np.where(truth.road_km <= odometer_km, truth.pace, truth.heat * truth.pace[now] / truth.heat[now])
    work = np.cumsum(np.where(truth.road_km >= life.begin_km, pace, 0.0)) * STEP_KM
    return lambda at_km: np.asarray(np.interp(at_km, truth.road_km, work))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Bins:
    """Means of the results with the last fluid."""

    at_km: FloatArray  # (m,)
    warmth_k: FloatArray
    value: FloatArray  # (2, m) mu_C and mu_S over those of new fluid, less one
    covariance: FloatArray  # (m, 2, 2)


def _binned(life: Life, odometer_km: float, errors: Errors) -> _Bins:
    past = life.history.first(life.rows_until(odometer_km)).since(life.rows_until(life.begin_km))
    at_km = past.odometer_m / M_PER_KM
    place = np.unique((at_km / BIN_KM).astype(np.int64), return_inverse=True)[1].reshape(-1)
    std = np.array([past.random_std_mu_c / REFERENCE.mu_c, past.random_std_mu_s / REFERENCE.mu_s])
    weight = std[0] ** -2

    def mean(value: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(place, weight * value) / np.bincount(place, weight))

    def of(one: tuple[float, float], correlation: float) -> FloatArray:
        off = correlation * one[0] * one[1]
        return np.array([[one[0] ** 2, off], [off, one[1] ** 2]])

    count = np.bincount(place)
    drives = np.minimum(count, BIN_KM / errors.drive_km)
    true = life.truth.noise_ratio
    single = (true * errors.stated[0], true * errors.stated[1])
    precise = np.bincount(place, weight) * errors.stated[0] ** 2  # results of usual precision
    return _Bins(
        at_km=mean(at_km),
        warmth_k=mean(past.sump_temperature_k - 353.15),
        value=np.array([mean(past.mu_c) / REFERENCE.mu_c, mean(past.mu_s) / REFERENCE.mu_s]) - 1.0,
        covariance=of(errors.drive, errors.drive_correlation) / drives[:, None, None]
        + of(single, errors.correlation) / precise[:, None, None],
    )


def _prior(life: Life, errors: Errors) -> tuple[FloatArray, FloatArray]:
    """Return mean and deviation of the unknowns."""
    is_bad = life.stratum is Stratum.BAD_LINING
    low, high = LINING_PER_KM[is_bad]
    offset = -0.04 if is_bad else 0.0
    drift = 1e-5 if life.stratum is Stratum.DRIFT else 1e-12
    values = {
        "new_c": (offset, 0.01),
        "new_s": (offset, 0.01),
        "scale": (0.0, errors.scale),
        "split_new": (0.0, errors.split_new),
        "slope_c": (-2.0e-4, 3.0e-4),
        "slope_s": (-2.0e-4, 3.0e-4),
        "lining": (0.5 * (low + high), (high - low) / 12.0**0.5),
        "share": (1.0, 0.4 / 12.0**0.5),
        "drift": (0.0, 0.02 * drift),
        "drift_apart": (0.0, 0.008 * drift),
        "split_gone": (0.0, errors.split_gone),
    }
    table = np.array([values[name] for name in UNKNOWNS])
    return table[:, 0], np.maximum(table[:, 1], 1e-12)


def _rows(life: Life, at_km: FloatArray, damage: FloatArray, warmth_k: FloatArray) -> FloatArray:
    """Return what each unknown adds to mu_C and mu_S over those of new fluid, shape (g, 2, m, p)."""
    one, nil = np.ones_like(damage), np.zeros_like(damage)
    worn, far, warm = (
        np.broadcast_to(value, damage.shape)
        for value in (-np.interp(at_km, life.truth.road_km, life.truth.lining_km), at_km, warmth_k)
    )
    by_share = -CASE_2 * damage
    of_c = (one, nil, one, nil, warm, nil, worn, by_share, far, nil, nil)
    gone = damage / GONE
    of_s = (nil, one, one, 1.0 - gone, nil, warm, worn, by_share, far, far, gone)
    return np.stack([np.stack(of_c, axis=-1), np.stack(of_s, axis=-1)], axis=1)


def _posterior(
    life: Life, bins: _Bins, damage: FloatArray, errors: Errors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means (g, p), covariances (g, p, p) and logarithms of evidence (g,) of the unknowns of each ageing."""
    mean, std = _prior(life, errors)
    rows = _rows(life, bins.at_km, damage, bins.warmth_k)
    known = np.zeros((len(damage), *bins.value.shape))
    known[:, 0] = np.interp(bins.at_km, life.truth.road_km, life.truth.run_in)
    known[:, 1] = 2.0 * CASE_2 * damage
    surprise = bins.value - known - rows @ mean
    whiten = np.linalg.inv(np.linalg.cholesky(bins.covariance))  # (m, 2, 2)
    white_rows = np.einsum("mab,gbmp->gamp", whiten, rows * std).reshape(len(damage), -1, len(std))
    white = np.einsum("mab,gbm->gam", whiten, surprise).reshape(len(damage), -1)
    precision = white_rows.swapaxes(1, 2) @ white_rows + np.eye(len(std))
    right = np.einsum("gnp,gn->gp", white_rows, white)
    solved = np.linalg.solve(precision, right[:, :, None])[:, :, 0]
    _, log_determinant = np.linalg.slogdet(precision)
    explained = np.sum(white**2, axis=1) - np.sum(right * solved, axis=1)
    return mean + solved * std, np.linalg.inv(precision) * np.outer(std, std), -0.5 * (explained + log_determinant)
