"""The running state of one vehicle and its update with considered parameters (Schmidt-Kalman).

Estimated: friction of both clutches, torque offset, touch-point and pressure-zero errors. Considered, that is carried
with their uncertainty but never estimated from driving: torque gain, engine inertia, piston areas, viscosity and the
latencies. They do not steer the gain, since their regressors share noise with the residual; they inflate the stated
covariance (docs/model.md, section "Estimator").
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from statistics import NormalDist
from typing import Any, Self

import numpy as np

from clutch_model.calibration import Calibration
from diag_service.records import FloatArray, FrictionEstimate

FRICTION_PRIOR_STD = 0.05  # a third of any lining's friction: weak against a single shift
FRICTION_DRIFT_STD = 2e-5  # per shift: 0.15 in the life of a fluid is 1e-6, so this forgets over thousands of shifts
OFFSET_DRIFT_NM = 0.005  # per shift: warm-up of the torque model
PRESSURE_DRIFT_PA = 5.0  # per shift: warm-up of the pressure sensors
STATE_FORMAT = 1


class State(IntEnum):
    """Index of each estimated parameter."""

    MU_C1 = 0
    MU_S1 = 1
    MU_C2 = 2
    MU_S2 = 3
    TORQUE_OFFSET = 4  # reading minus truth [Nm]
    TOUCH1 = 5  # touch pressure minus calibration [Pa]
    TOUCH2 = 6
    ZERO1 = 7  # pressure reading minus truth [Pa]
    ZERO2 = 8


class Considered(IntEnum):
    """Index of each parameter that is carried but not estimated."""

    TORQUE_GAIN = 0
    ENGINE_INERTIA = 1
    PISTON_AREA1 = 2
    PISTON_AREA2 = 3
    VISCOSITY = 4
    TORQUE_LATENCY = 5
    PRESSURE_LATENCY = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """Linearised residuals: ``residual = by_state @ dx + by_considered @ c + noise``."""

    residual: FloatArray  # (m,)
    by_state: FloatArray  # (m, len(State))
    by_considered: FloatArray  # (m, len(Considered))
    noise: FloatArray  # (m, m) covariance


@dataclass(frozen=True, slots=True, kw_only=True)
class Belief:
    """Mean of the estimated state, covariance of its random error, and what the considered parameters do to it.

    The error of the state is a random part plus ``sensitivity @ c``, with c the errors of the considered parameters.
    """

    mean: FloatArray  # (len(State),)
    covariance: FloatArray  # (len(State), len(State)), random part
    sensitivity: FloatArray  # (len(State), len(Considered))
    considered: FloatArray  # (len(Considered),) variances
    shift_counts: tuple[int, int] = (0, 0)
    refused_counts: tuple[int, int] = (0, 0)  # shifts in a row that disagreed with the running state
    clutch_temperature_k: tuple[float, float] | None = None
    temperature_ns: int = 0
    stribeck_speed_rad_s: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def fresh(cls, calibration: Calibration) -> Self:
        """Return the state of a vehicle of which nothing is known but its calibration."""
        scatter = calibration.uncertainty
        curves = [clutch.friction for clutch in calibration.clutches]
        mean = np.zeros(len(State))
        mean[: State.MU_S2 + 1] = [value for curve in curves for value in (curve.mu_c, curve.mu_s)]
        touch, zero = scatter.touch_pressure_pa, scatter.pressure_zero_pa
        std = [FRICTION_PRIOR_STD] * 4 + [scatter.torque_offset_nm, touch, touch, zero, zero]
        considered = [
            scatter.torque_gain_ratio,
            scatter.engine_inertia_ratio,
            scatter.piston_area_ratio,
            scatter.piston_area_ratio,
            scatter.viscosity_ratio,
            scatter.torque_latency_s,
            scatter.pressure_latency_s,
        ]
        return cls(
            mean=mean,
            covariance=np.diag(np.square(std)),
            sensitivity=np.zeros((len(State), len(Considered))),
            considered=np.square(considered),
            stribeck_speed_rad_s=(curves[0].stribeck_speed_rad_s, curves[1].stribeck_speed_rad_s),
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
        return replace(self, mean=mean, covariance=covariance, sensitivity=sensitivity)

    def drifted(self) -> Self:
        """Return the state one shift later: every estimated parameter wanders a little."""
        wander = [FRICTION_DRIFT_STD] * 4 + [OFFSET_DRIFT_NM] + [PRESSURE_DRIFT_PA] * 4
        return replace(self, covariance=self.covariance + np.diag(np.square(wander)))

    def updated(self, seen: Measurement) -> tuple[Self, float]:
        """Return the state after a measurement, and the chi-square of its residual per degree of freedom."""
        h, d = seen.by_state, seen.by_considered
        random = h @ self.covariance @ h.T + seen.noise
        gain = np.linalg.solve(random, h @ self.covariance).T
        keep = np.eye(len(State)) - gain @ h
        covariance = keep @ self.covariance @ keep.T + gain @ seen.noise @ gain.T
        common = d - h @ self.sensitivity
        expected = random + (common * self.considered) @ common.T
        chi_square = float(seen.residual @ np.linalg.solve(expected, seen.residual))
        state = replace(
            self,
            mean=self.mean + gain @ seen.residual,
            covariance=(covariance + covariance.T) / 2.0,
            sensitivity=keep @ self.sensitivity + gain @ d,
        )
        return state, chi_square / len(seen.residual)

    def total_covariance(self, rows: slice) -> FloatArray:
        """Return the covariance of some states, common scale included."""
        sensitivity = self.sensitivity[rows]
        return self.covariance[rows, rows] + (sensitivity * self.considered) @ sensitivity.T

    def friction(self, clutch: int) -> FrictionEstimate:
        """Return the friction of clutch 1 or 2 as now believed."""
        rows = friction_rows(clutch)
        total = self.total_covariance(rows)
        std, random_std = np.sqrt(np.diag(total)), np.sqrt(np.diag(self.covariance[rows, rows]))
        mu_c, mu_s = self.mean[rows]
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

    def to_json(self) -> dict[str, Any]:
        """Return the state as JSON-ready values; floats survive the round trip bit by bit."""
        return {
            "format": STATE_FORMAT,
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "sensitivity": self.sensitivity.tolist(),
            "shift_counts": list(self.shift_counts),
            "refused_counts": list(self.refused_counts),
            "clutch_temperature_k": self.clutch_temperature_k and list(self.clutch_temperature_k),
            "temperature_ns": self.temperature_ns,
        }

    @classmethod
    def from_json(cls, table: dict[str, Any], calibration: Calibration) -> Self:
        """Rebuild a state saved by `to_json` under the same calibration.

        Raises
        ------
        ValueError
            If the table is not such a state.
        """
        blank = cls.fresh(calibration)
        try:
            if table["format"] != STATE_FORMAT:
                raise ValueError(f"running state of format {table['format']!r}, expected {STATE_FORMAT}")
            temperature = table["clutch_temperature_k"]
            state = replace(
                blank,
                mean=np.array(table["mean"], dtype=np.float64),
                covariance=np.array(table["covariance"], dtype=np.float64),
                sensitivity=np.array(table["sensitivity"], dtype=np.float64),
                shift_counts=_pair(table["shift_counts"], int),
                refused_counts=_pair(table["refused_counts"], int),
                clutch_temperature_k=None if temperature is None else _pair(temperature, float),
                temperature_ns=int(table["temperature_ns"]),
            )
        except (KeyError, TypeError) as exc:
            raise ValueError(f"not a running state: {exc!r}") from exc
        for name in ("mean", "covariance", "sensitivity"):
            value = getattr(state, name)
            if value.shape != getattr(blank, name).shape or not np.all(np.isfinite(value)):
                raise ValueError(f"not a running state: bad {name}")
        return state


def friction_rows(clutch: int) -> slice:
    """Return the state rows (mu_C, mu_S) of clutch 1 or 2."""
    return slice(2 * clutch - 2, 2 * clutch)


def _pair(values: Any, kind: type) -> tuple[Any, Any]:  # noqa: ANN401 - JSON is untyped
    first, second = values
    return kind(first), kind(second)
