"""The running state of one vehicle and its update with considered parameters (Schmidt-Kalman).

Estimated: friction of both clutches, torque offset, touch-point and pressure-zero errors. Considered, that is carried
with their uncertainty but not estimated from shift to shift: torque gain, engine inertia, piston areas, latencies and
what else `Considered` lists. They inflate the stated covariance; those of film and lining also steer the gain, away
from what depends on them (docs/model.md, section "Estimator"). A self-calibration finds some of them from many shifts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from statistics import NormalDist
from typing import Final, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.gears import both_clutches, with_clutch
from diag_service.diagnosis.friction.baseline import BASELINE_SHIFT_COUNT, SHAPES, Baseline
from diag_service.diagnosis.friction.parameters import (
    STATE_COUNT,
    Considered,
    State,
    friction_rows,
    prior_covariance,
    prior_mean,
)
from diag_service.diagnosis.friction.perturbations import COMMON
from diag_service.diagnosis.plain_values import from_plain, to_plain
from diag_service.diagnosis.quality.plausibility import PressureZeros
from diag_service.diagnosis.records import FrictionEstimate
from fleet_contract import JsonObject

FRICTION_DRIFT_STD = 2e-5  # per shift: 0.15 in the life of a fluid is 1e-6, so this forgets over thousands of shifts
OFFSET_DRIFT_NM = 0.005  # per shift: warm-up of the torque model
PRESSURE_DRIFT_PA = 5.0  # per shift: warm-up of the pressure sensors
STATE_FORMAT = 3
_STORED: Final = (
    *("mean", "covariance", "sensitivity", "shift_counts", "refused_counts"),
    *("clutch_temperature_k", "temperature_ns", "baselines"),
)
STEERING = list(COMMON)  # their derivatives come from planned films; those of the others share noise with the residual
LEAST_REACH = 1e-12  # a considered parameter that a residual does not show
MAX_MISFIT = 4.0  # chi-square per degree of freedom; a clean shift stays below 2.5
MAX_EXCESS = 48.0  # of chi-square over its expectation: an error adds as much to few numbers as to many


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """Linearised residuals: ``residual = by_state @ dx + by_considered @ c + noise``.

    ``overlap`` is the expectation of ``by_considered.T @ inv(noise) @ noise``: what the sensor noise that a derivative
    shares with the residual adds to the gradient of a fit that estimates the considered parameters.
    """

    residual: FloatArray  # (m,)
    by_state: FloatArray  # (m, len(State))
    by_considered: FloatArray  # (m, len(Considered))
    noise: FloatArray  # (m, m) covariance
    overlap: FloatArray | None = None  # (len(Considered),); None: nothing is shared

    @property
    def misfit_gate(self) -> float:
        """The chi-square per degree of freedom beyond which the model does not explain the residual."""
        return min(MAX_MISFIT, 1.0 + MAX_EXCESS / len(self.residual))


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfit:
    """How far a residual is from what was expected."""

    chi_square_ratio: float  # per degree of freedom
    worst_score: float  # standard deviations along the considered parameter that is displaced the farthest


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterState:
    """Mean of the estimated state, covariance of its random error, and what the considered parameters do to it.

    The error of the state, estimate minus truth, is a random part plus ``sensitivity @ c``, with c the truth of the
    considered parameters minus their values in the calibration.
    """

    mean: FloatArray  # (len(State),)
    covariance: FloatArray  # (len(State), len(State)), random part
    sensitivity: FloatArray  # (len(State), len(Considered))
    considered: FloatArray  # (len(Considered), len(Considered)) covariance
    shift_counts: tuple[int, int] = (0, 0)
    refused_counts: tuple[int, int] = (0, 0)  # shifts in a row that disagreed with the running state
    clutch_temperature_k: tuple[float, float] | None = None
    temperature_ns: int = 0
    stribeck_speed_rad_s: tuple[float, float] = (1.0, 1.0)
    torque_gain: float = 1.0  # of the readings, as believed: friction in ``mean`` is multiplied by it
    baselines: tuple[Baseline | None, Baseline | None] = (None, None)  # of clutch 1 and 2, once there are enough shifts

    @classmethod
    def fresh(cls, calibration: Calibration) -> Self:
        """Return the state of a vehicle of which nothing is known but its calibration."""
        return cls.joint(prior_mean(calibration), prior_covariance(calibration), calibration)

    @classmethod
    def joint(cls, mean: FloatArray, covariance: FloatArray, calibration: Calibration) -> Self:
        """Return the state of a vehicle whose parameters have this joint covariance.

        Parameters
        ----------
        mean : (len(State),) array
            Estimated parameters; the considered ones have the values of the calibration.
        covariance : (len(NAMES), len(NAMES)) array
            States first, then the considered parameters.
        """
        states, considered = slice(STATE_COUNT), slice(STATE_COUNT, None)
        spread = covariance[considered, considered]
        scale = np.sqrt(np.diag(spread))
        scale[scale == 0.0] = 1.0  # certain; explains nothing
        explained = np.linalg.pinv(spread / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
        sensitivity = -covariance[states, considered] @ explained  # an error is estimate minus truth, ``c`` the reverse
        random = covariance[states, states] - sensitivity @ spread @ sensitivity.T
        return cls(
            mean=mean,
            covariance=(random + random.T) / 2.0,
            sensitivity=sensitivity,
            considered=spread,
            torque_gain=calibration.bias.torque_gain,
            stribeck_speed_rad_s=both_clutches(one.friction.stribeck_speed_rad_s for one in calibration.clutches),
        )

    def forget_friction(self, clutch: int, calibration: Calibration) -> Self:
        """Return the state with the friction of one clutch unknown again, everything else kept."""
        rows = friction_rows(clutch)
        blank = type(self).fresh(calibration)
        mean, covariance, sensitivity = self.mean.copy(), self.covariance.copy(), self.sensitivity.copy()
        mean[rows] = blank.mean[rows]
        covariance[rows, :] = 0.0
        covariance[:, rows] = 0.0
        covariance[rows, rows] = blank.covariance[rows, rows]
        sensitivity[rows, :] = 0.0
        baselines = both_clutches(one and one.without(rows) for one in self.baselines)
        return replace(self, mean=mean, covariance=covariance, sensitivity=sensitivity, baselines=baselines)

    def with_new_fluid(self, calibration: Calibration) -> Self:
        """Return the state after a fluid fill: friction is unknown again, and its baseline with it; the rest stays."""
        blank = replace(self, baselines=(None, None), shift_counts=(0, 0), refused_counts=(0, 0))
        return blank.forget_friction(1, calibration).forget_friction(2, calibration)

    def counted(self, clutch: int, end_ns: int) -> Self:
        """Return the state after the baseline of a clutch took note of a shift that the friction now contains.

        The baseline is frozen at the first shift with which the clutch has had enough of them, and stays.
        """
        rows, count = friction_rows(clutch), self.shift_counts[clutch - 1]
        baseline = self.baselines[clutch - 1]
        if baseline is not None:
            baseline = replace(baseline, later_count=baseline.later_count + 1)
        elif count >= BASELINE_SHIFT_COUNT:
            baseline = Baseline.of(rows, self.mean, self.covariance, self.sensitivity, end_ns=end_ns, count=count)
        return replace(self, baselines=with_clutch(self.baselines, clutch, baseline))

    def warmed(self, clutch_temperature_k: tuple[float, float], at_ns: int) -> Self:
        """Return the state with the temperatures of both packs at a bus time."""
        return replace(self, clutch_temperature_k=clutch_temperature_k, temperature_ns=at_ns)

    def drifted(self) -> Self:
        """Return the state one shift later: every estimated parameter wanders a little."""
        wander = [FRICTION_DRIFT_STD] * 4 + [OFFSET_DRIFT_NM] + [PRESSURE_DRIFT_PA] * 4
        return replace(self, covariance=self.covariance + np.diag(np.square(wander)))

    def updated(self, seen: Measurement) -> tuple[Self, Misfit]:
        """Return the state after a measurement, and how well its residual fits."""
        h, d = seen.by_state, seen.by_considered
        random = h @ self.covariance @ h.T + seen.noise
        common = d - h @ self.sensitivity
        gain = self._gain(h, common, random)
        keep = np.eye(len(State)) - gain @ h
        covariance = keep @ self.covariance @ keep.T + gain @ seen.noise @ gain.T
        expected = random + common @ self.considered @ common.T
        directions = common[:, np.diag(self.considered) > 0.0]
        scaled = np.linalg.solve(expected, np.column_stack((seen.residual, directions)))
        reach = np.sqrt(np.maximum(np.einsum("ij,ij->j", directions, scaled[:, 1:]), LEAST_REACH))
        misfit = Misfit(
            chi_square_ratio=float(seen.residual @ scaled[:, 0]) / len(seen.residual),
            worst_score=float(np.max(np.abs(directions.T @ scaled[:, 0]) / reach, initial=0.0)),
        )
        state = replace(
            self,
            mean=self.mean + gain @ seen.residual,
            covariance=(covariance + covariance.T) / 2.0,
            sensitivity=keep @ self.sensitivity + gain @ d,
            baselines=both_clutches(one and one.after(keep) for one in self.baselines),
        )
        return state, misfit

    def _gain(self, by_state: FloatArray, common: FloatArray, random: FloatArray) -> FloatArray:
        """Return the gain of an update, shape (len(State), m): docs/model.md eq. (22)."""
        spread = self.considered[np.ix_(STEERING, STEERING)]
        steered = spread @ common[:, STEERING].T
        crossed = by_state @ self.covariance - steered.T @ self.sensitivity[:, STEERING].T
        return np.asarray(np.linalg.solve(random + common[:, STEERING] @ steered, crossed).T, np.float64)

    @property
    def pressure_zeros(self) -> PressureZeros:
        """What is known of the zeros of the pressure sensors."""
        zeros = slice(State.ZERO1, State.ZERO2 + 1)
        return PressureZeros(mean_pa=self.mean[zeros], variance_pa2=np.diag(self.covariance)[zeros])

    def total_covariance(self, rows: slice) -> FloatArray:
        """Return the covariance of some states, common scale included."""
        sensitivity = self.sensitivity[rows]
        return self.covariance[rows, rows] + sensitivity @ self.considered @ sensitivity.T

    def friction(self, clutch: int) -> FrictionEstimate:
        """Return the friction of clutch 1 or 2 as now estimated."""
        rows = friction_rows(clutch)
        mu_c, mu_s = self.mean[rows] / self.torque_gain
        sensitivity = self.sensitivity[rows] / self.torque_gain
        sensitivity[:, Considered.TORQUE_GAIN] += np.array([mu_c, mu_s]) / self.torque_gain
        random = self.covariance[rows, rows] / self.torque_gain**2
        total = random + sensitivity @ self.considered @ sensitivity.T
        std, random_std = np.sqrt(np.diag(total)), np.sqrt(np.diag(random))
        width = self.stribeck_speed_rad_s[clutch - 1]
        std_difference = float(np.sqrt(total[0, 0] + total[1, 1] - 2.0 * total[0, 1]))
        return FrictionEstimate(
            mu_c=float(mu_c),
            mu_s=float(mu_s),
            std_mu_c=float(std[0]),
            std_mu_s=float(std[1]),
            correlation=float(total[0, 1] / (std[0] * std[1])),
            random_std_mu_c=float(random_std[0]),
            random_std_mu_s=float(random_std[1]),
            slope_s_rad=float(mu_c - mu_s) / width,
            std_slope_s_rad=std_difference / width,
            probability_negative_slope=NormalDist(float(mu_c - mu_s), std_difference).cdf(0.0),
        )

    def to_json(self) -> JsonObject:
        """Return the state as JSON-ready values; floats survive the round trip bit by bit."""
        plain = to_plain(self)
        return {"format": STATE_FORMAT} | {name: plain[name] for name in _STORED}

    @classmethod
    def from_json(cls, table: Mapping[str, object], calibration: Calibration) -> Self:
        """Rebuild a state saved by `to_json` under the same calibration.

        Raises
        ------
        ValueError
            If the table is not such a state.
        """
        if table.get("format") != STATE_FORMAT:
            raise ValueError(f"running state of format {table.get('format')!r}, expected {STATE_FORMAT}")
        blank = cls.fresh(calibration)
        try:
            given = {one.name: getattr(blank, one.name) for one in fields(cls)}
            state = from_plain(given | {name: table[name] for name in _STORED}, cls)
        except (KeyError, ValueError) as exc:
            raise ValueError(f"not a running state: {exc}") from exc
        shapes = {name: getattr(blank, name).shape for name in ("mean", "covariance", "sensitivity")}
        for record, expected in ((state, shapes), *((one, SHAPES) for one in state.baselines if one is not None)):
            for name, shape in expected.items():
                value = getattr(record, name)
                if value.shape != shape or not np.all(np.isfinite(value)):
                    raise ValueError(f"not a running state: bad {name} of a {type(record).__name__}")
        return state
