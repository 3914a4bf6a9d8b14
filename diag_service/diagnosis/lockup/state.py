"""What is known of a lock-up clutch and its converter, all together, and how much a stretch of driving adds to it.

Errors of the engine's torque last for seconds, so neighbouring blocks share them: what the residuals of a vehicle show
of their correlation decides how many blocks count as one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import Final, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_results import records
from clutch_results.event_kinds import MicroSlip, Shudder
from diag_service.diagnosis.lockup.blocks import (
    FRICTION_COUNT,
    MICRO_SLIP_RAD_S,
    PARAMETER_START,
    Blocks,
    weight_at_40_rpm,
)
from fleet_contract import JsonObject

ALGORITHM_VERSION: Final = "lockup-balance-1"
STATE_FORMAT: Final = 1
LAG_COUNT: Final = 24  # twelve seconds: what lasts longer is an offset of its own
EXPECTED_CORRELATION: Final = 0.8  # from block to block, before residuals have told; a torque model errs for seconds
EXPECTED_WEIGHT: Final = 60.0  # blocks that the expectation counts for
BLOCK_STD_NM: Final = 2.0  # likewise, of one block
LOAD_RATIO: Final = 0.01  # of the clutch's torque: pressure, heat and lining differ from minute to minute
UNKNOWN_STD: Final = 0.1  # of friction
LEAST_STD: Final = 1e-6  # of what a description calls certain: a covariance must have an inverse
SHAPE_RATIO: Final = 0.03  # of capacities, each by itself
EVENT_OFFSET_NM: Final = 0.7  # per stretch: what else the engine drives
EVENT_FRICTION_STD: Final = 1e-4  # per stretch: heat and running-in
EVENT_MARGIN_STD: Final = 5e-5
BASELINE_COUNT: Final = 15  # stretches
MISFIT_RATIO: Final = 25.0  # of the variance of blocks to that expected: no converter behind such torque
CONTRADICTION: Final = 9.2  # squared distance of two numbers: 1 % by chance, three in a row 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """Friction at 40 rpm, and mu_C - mu_S, as first known well; scale-free."""

    mean: FloatArray  # (2,)
    variance: FloatArray  # (2, 2)
    end_ns: int
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LockupState:
    """Mean and covariance of all parameters in readings of torque, and what residuals have shown."""

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    lag_sums: FloatArray  # (LAG_COUNT,) of products of residuals so many blocks apart
    lag_counts: FloatArray  # (LAG_COUNT,)
    shift_count: int = 0
    slip_s: float = 0.0
    contradiction_count: int = 0  # in a row
    baseline: Baseline | None = None
    calibration: Calibration = field(compare=False)

    @classmethod
    def fresh(cls, calibration: Calibration) -> Self:
        """Return what is known before the first drive: the type."""
        converter = calibration.converter
        if converter is None:
            raise ValueError("the calibration has no converter")
        curve, spread = calibration.clutches[0].friction, calibration.uncertainty
        share = weight_at_40_rpm(calibration)
        margin = curve.mu_c - curve.mu_s
        size = PARAMETER_START + len(converter.speed_ratios)
        mean = np.zeros(size)
        mean[:FRICTION_COUNT] = curve.mu_c - share * margin, margin
        covariance = np.zeros((size, size))
        own = (
            UNKNOWN_STD,
            UNKNOWN_STD,
            spread.friction_temperature_1_k,
            spread.torque_offset_nm,
            math.hypot(spread.pressure_zero_pa, spread.touch_pressure_pa),
            math.hypot(spread.engine_inertia_ratio, spread.torque_gain_ratio),
        )
        covariance[np.arange(len(own)), np.arange(len(own))] = np.maximum(own, LEAST_STD) ** 2
        covariance[PARAMETER_START:, PARAMETER_START:] = converter.capacity_ratio**2 + spread.torque_gain_ratio**2
        covariance[PARAMETER_START:, PARAMETER_START:] += SHAPE_RATIO**2 * np.eye(len(converter.speed_ratios))
        expected = BLOCK_STD_NM**2 * np.power(EXPECTED_CORRELATION, np.arange(LAG_COUNT, dtype=np.float64))
        return cls(
            mean=mean,
            covariance=covariance,
            lag_sums=EXPECTED_WEIGHT * expected,
            lag_counts=np.full(LAG_COUNT, EXPECTED_WEIGHT),
            calibration=calibration,
        )

    @property
    def block_variance_nm2(self) -> float:
        return float(self.lag_sums[0] / self.lag_counts[0])

    @property
    def blocks_as_one(self) -> float:
        """How many neighbouring blocks tell as much as one that stands alone: correlations weighted as Bartlett did."""
        correlation = self.lag_sums / self.lag_counts / self.block_variance_nm2
        weight = 1.0 - np.arange(LAG_COUNT) / LAG_COUNT
        return max(1.0, float(2.0 * (weight * correlation).sum() - 1.0))

    def fused(self, blocks: Blocks) -> Self:
        """Return what is known with the blocks of a stretch."""
        alone_nm2 = self.block_variance_nm2 + (LOAD_RATIO * blocks.clutch_nm) ** 2
        rows, noise = blocks.rows, alone_nm2 * self.blocks_as_one  # neighbours share theirs
        information = np.linalg.inv(self.covariance)
        added = (rows / noise[:, None]).T
        covariance = np.linalg.inv(information + added @ rows)
        covariance = 0.5 * (covariance + covariance.T)
        innovation = blocks.torque_nm - rows @ self.mean
        return replace(self, mean=self.mean + covariance @ (added @ innovation), covariance=covariance)

    def residuals_nm(self, blocks: Blocks) -> FloatArray:
        return blocks.torque_nm - blocks.rows @ self.mean

    def misfit(self, blocks: Blocks) -> float:
        """Return the mean square of residuals over what is expected."""
        expected = self.block_variance_nm2 + (LOAD_RATIO * blocks.clutch_nm) ** 2
        return float(np.mean(self.residuals_nm(blocks) ** 2 / expected))

    def with_lags(self, blocks: Blocks) -> Self:
        """Return the state with what the residuals of a stretch show of their size and correlation."""
        scale = 1.0 + (LOAD_RATIO * blocks.clutch_nm) ** 2 / self.block_variance_nm2
        by_place = np.full(int(blocks.place[-1] - blocks.place[0]) + 1, np.nan)
        by_place[blocks.place - blocks.place[0]] = self.residuals_nm(blocks) / np.sqrt(scale)
        sums, counts = self.lag_sums.copy(), self.lag_counts.copy()
        for lag in range(min(LAG_COUNT, len(by_place))):
            products = by_place[lag:] * by_place[: len(by_place) - lag]
            is_there = np.isfinite(products)
            sums[lag] += products[is_there].sum()
            counts[lag] += np.count_nonzero(is_there)
        return replace(self, lag_sums=sums, lag_counts=counts)

    def with_unknown_friction(self) -> Self:
        """Return the state with the friction of the clutch unknown again, all else kept."""
        type_mean = LockupState.fresh(self.calibration).mean
        mean, covariance = self.mean.copy(), self.covariance.copy()
        rows = slice(0, FRICTION_COUNT)
        mean[rows] = type_mean[rows]
        covariance[rows, :] = 0.0
        covariance[:, rows] = 0.0
        covariance[rows, rows] = np.eye(FRICTION_COUNT) * UNKNOWN_STD**2
        return replace(self, mean=mean, covariance=covariance)

    def with_new_fluid(self) -> Self:
        """Return the state after a fluid fill: friction is unknown again, and its baseline with it; the rest stays."""
        return replace(self.with_unknown_friction(), shift_count=0, slip_s=0.0, contradiction_count=0, baseline=None)

    def aged(self) -> Self:
        """Return the state as it is known some minutes later."""
        variance = np.zeros(len(self.mean))
        variance[:2] = EVENT_FRICTION_STD**2, EVENT_MARGIN_STD**2
        variance[3] = EVENT_OFFSET_NM**2
        return replace(self, covariance=self.covariance + np.diag(variance))

    def contradicts(self, alone: "LockupState") -> bool:
        """Return whether a stretch that knew nothing of friction finds another one than this."""
        apart = alone.mean[:FRICTION_COUNT] - self.mean[:FRICTION_COUNT]
        both = alone.covariance[:FRICTION_COUNT, :FRICTION_COUNT] + self.covariance[:FRICTION_COUNT, :FRICTION_COUNT]
        return float(apart @ np.linalg.solve(both, apart)) > CONTRADICTION

    def with_baseline(self, end_ns: int) -> Self:
        """Return the state with a baseline, once there is enough for one."""
        if self.baseline is not None or self.shift_count < BASELINE_COUNT:
            return self
        rows = slice(0, FRICTION_COUNT)
        now = Baseline(
            mean=self.mean[rows], variance=self.covariance[rows, rows], end_ns=end_ns, count=self.shift_count
        )
        return replace(self, baseline=now)

    # What is said of it.

    @property
    def _share(self) -> float:
        return weight_at_40_rpm(self.calibration)

    def _by_level(self) -> FloatArray:
        """Return mu_C, mu_S and friction at 40 rpm of the two parameters, shape (3, 2)."""
        share = self._share
        return np.array([[1.0, share], [1.0, share - 1.0], [1.0, 0.0]])

    def _covariance(self) -> FloatArray:
        """Return the covariance of (mu_C, mu_S, mu at 40 rpm), scale-free; the shape of the curve is not known well."""
        by = self._by_level()
        covariance = by @ self.covariance[:FRICTION_COUNT, :FRICTION_COUNT] @ by.T
        spread = self.calibration.uncertainty.stribeck_speed_ratio * abs(float(self.mean[1]))
        bent = spread * np.array([self._share, 1.0 - self._share, 0.0])
        return covariance + np.outer(bent, bent)

    def scale_ratio(self) -> float:
        """Return the relative deviation that all friction of the clutch shares."""
        spread = self.calibration.uncertainty
        return math.hypot(spread.torque_gain_ratio, spread.piston_area_ratio)

    def scale_free(self) -> records.ScaleFreeFriction:
        mu_c, mu_s, _ = (self._by_level() @ self.mean[:FRICTION_COUNT]).tolist()
        covariance = self._covariance()
        std_c, std_s = math.sqrt(covariance[0, 0]), math.sqrt(covariance[1, 1])
        return records.ScaleFreeFriction(
            mu_c=mu_c, mu_s=mu_s, std_mu_c=std_c, std_mu_s=std_s, correlation=float(covariance[0, 1] / (std_c * std_s))
        )

    def friction(self) -> records.FrictionEstimate:
        free, covariance = self.scale_free(), self._covariance()[:2, :2]
        level = np.array([free.mu_c, free.mu_s]) / self.calibration.bias.torque_gain
        total = covariance + self.scale_ratio() ** 2 * np.outer(level, level)
        std_c, std_s = np.sqrt(total.diagonal()).tolist()
        speed = self.calibration.clutches[0].friction.stribeck_speed_rad_s
        margin = NormalDist(float(level[0] - level[1]), self._margin_std())
        return records.FrictionEstimate(
            mu_c=float(level[0]),
            mu_s=float(level[1]),
            std_mu_c=std_c,
            std_mu_s=std_s,
            correlation=float(total[0, 1] / (std_c * std_s)),
            random_std_mu_c=free.std_mu_c,
            random_std_mu_s=free.std_mu_s,
            slope_s_rad=margin.mean / speed,
            std_slope_s_rad=margin.stdev / speed,
            probability_negative_slope=margin.cdf(0.0),
        )

    def _margin_std(self) -> float:
        """Return the deviation of mu_C - mu_S; what scales it moves no sign, and is in it in proportion."""
        margin = float(self.mean[1])
        scale = math.hypot(self.scale_ratio(), self.calibration.uncertainty.stribeck_speed_ratio)
        return math.hypot(math.sqrt(self.covariance[1, 1]), scale * margin)

    def micro_slip(self, shudder: Shudder | None) -> MicroSlip:
        """Return friction and slope at 40 rpm, and how much they rest on."""
        mu, std = float(self.mean[0]), math.sqrt(self.covariance[0, 0])
        speed, share = self.calibration.clutches[0].friction.stribeck_speed_rad_s, self._share
        level = mu / self.calibration.bias.torque_gain
        return MicroSlip(
            slip_rad_s=MICRO_SLIP_RAD_S,
            mu=level,
            std_mu=math.hypot(std, self.scale_ratio() * level),
            scale_free_mu=mu,
            std_scale_free_mu=std,
            slope_s_rad=share * float(self.mean[1]) / speed,
            std_slope_s_rad=share * self._margin_std() / speed,
            slip_s=self.slip_s,
            blocks_as_one=self.blocks_as_one,
            shudder=shudder,
        )

    def trend(self) -> records.FrictionTrend | None:
        """Return the change since the baseline; the errors of both count as independent, which is too much."""
        if (baseline := self.baseline) is None:
            return None
        rows = slice(0, FRICTION_COUNT)
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[rows], covariance[rows, rows] = baseline.mean, baseline.variance
        before = replace(self, mean=mean, covariance=covariance)
        then, now = before.scale_free(), self.scale_free()
        ratio_c, ratio_s = now.mu_c / then.mu_c, now.mu_s / then.mu_s
        gain = self.calibration.bias.torque_gain
        return records.FrictionTrend(
            change_mu_c=(now.mu_c - then.mu_c) / gain,
            change_mu_s=(now.mu_s - then.mu_s) / gain,
            std_change_mu_c=math.hypot(now.std_mu_c, then.std_mu_c) / gain,
            std_change_mu_s=math.hypot(now.std_mu_s, then.std_mu_s) / gain,
            change_mu_c_ratio=ratio_c - 1.0,
            change_mu_s_ratio=ratio_s - 1.0,
            std_change_mu_c_ratio=math.hypot(now.std_mu_c, ratio_c * then.std_mu_c) / then.mu_c,
            std_change_mu_s_ratio=math.hypot(now.std_mu_s, ratio_s * then.std_mu_s) / then.mu_s,
            baseline_end_bus_ns=baseline.end_ns,
            baseline_shift_count=baseline.count,
            later_shift_count=self.shift_count - baseline.count,
        )

    def to_json(self) -> JsonObject:
        """Return the state as JSON-ready values; floats survive the round trip bit by bit."""
        kept = _Stored(**{name: getattr(self, name) for name in _Stored.__dataclass_fields__})
        return {"format": STATE_FORMAT, **records.to_plain(kept)}

    @classmethod
    def from_json(cls, table: Mapping[str, object], calibration: Calibration) -> Self:
        """Rebuild a state saved by `to_json` under the same calibration; raises ValueError if it is none."""
        blank = cls.fresh(calibration)
        if table.get("format") != STATE_FORMAT:
            raise ValueError(f"running state of format {table.get('format')!r}, expected {STATE_FORMAT}")
        try:
            kept = records.from_plain({key: value for key, value in table.items() if key != "format"}, _Stored)
        except (TypeError, ValueError) as exc:
            raise ValueError(f"not a running state: {exc}") from exc
        for name in ("mean", "covariance", "lag_sums", "lag_counts"):
            value = getattr(kept, name)
            if value.shape != getattr(blank, name).shape or not np.all(np.isfinite(value)):
                raise ValueError(f"not a running state: bad {name}")
        return replace(blank, **{name: getattr(kept, name) for name in _Stored.__dataclass_fields__})


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stored:
    """The members of a state that are stored."""

    mean: FloatArray
    covariance: FloatArray
    lag_sums: FloatArray
    lag_counts: FloatArray
    shift_count: int
    slip_s: float
    contradiction_count: int
    baseline: Baseline | None
