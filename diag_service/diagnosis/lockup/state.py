"""What is known of a lock-up clutch and its converter, all together, and how much a stretch of driving adds to it.

Errors of the engine's torque last for seconds, so neighbouring blocks share them: what the residuals of a vehicle show
of their correlation decides how many blocks count as one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from statistics import NormalDist
from typing import Final, Self

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from clutch_model.calibration import Calibration, Converter
from clutch_model.pack import contact_torques_nm, film_law, friction_law, stribeck_weights
from clutch_model.units import NS_PER_S
from clutch_results import records
from clutch_results.event_kinds import MicroSlip, Shudder
from diag_service.diagnosis.columns import LOCKUP_SIGNALS, Columns, Signal
from fleet_contract import JsonObject

MICRO_SLIP_RAD_S: Final = 40.0 * np.pi / 30.0  # 40 rpm, at which friction is stated: amid what controllers hold
BLOCK_NS: Final = NS_PER_S // 2
LONGEST_GAP_NS: Final = NS_PER_S // 10  # between samples that a line may join
LEAST_SAMPLES: Final = 10  # of each signal in a block: 20 a second
LEAST_SLIP_RAD_S: Final = 0.8  # of the mean; closer to lock a tooth decides
MOST_SLIP_RAD_S: Final = 30.0  # faster, a clutch is being applied or let go
MOST_RATE_RAD_S2: Final = 40.0  # of the engine: faster, late torque is no balance
MOST_SLIP_RATE_RAD_S2: Final = 6.0  # likewise
MOST_PRESSURE_STEP_PA: Final = 0.4e5  # within a block
LEAST_PRESSURE_PA: Final = 0.3e5  # beyond touch, for a clutch that carries; as far below it is open
MOST_SWING_RATIO: Final = 0.25  # root mean square of the slip, over its mean
LEAST_TURNING_RAD_S: Final = 60.0  # of the engine
_MARGIN: Final = 1  # place of mu_C - mu_S among the parameters
FRICTION_COUNT: Final = 2  # friction at 40 rpm, and mu_C - mu_S
OTHERS: Final = ("temperature", "offset", "pressure", "inertia")  # then the capacities at the converter's speed ratios
PARAMETER_START: Final = FRICTION_COUNT + len(OTHERS)


class Kind(IntEnum):
    """What the lock-up clutch does in a block."""

    OTHER = 0
    OPEN = 1
    SLIPPING = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LockupSamples:
    """Signals at the times of the engine speed's samples, shape (n,) each."""

    t_ns: Int64Array
    engine_rad_s: FloatArray
    turbine_rad_s: FloatArray
    torque_nm: FloatArray
    pressure_pa: FloatArray
    oil_k: FloatArray
    is_bridged: BoolArray  # a signal has no sample near

    @property
    def slip_rad_s(self) -> FloatArray:
        return self.engine_rad_s - self.turbine_rad_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocks:
    """Blocks that tell something; ``place`` counts half seconds, so that neighbours are known."""

    place: Int64Array  # (m,)
    kind: Int64Array  # (m,) of `Kind`
    rows: FloatArray  # (m, p) torque [N m] by each parameter
    torque_nm: FloatArray  # (m,) that is to be explained
    clutch_nm: FloatArray  # (m,) of it through the clutch, as the type has it
    energy_j: float  # that slip made heat

    @property
    def slip_s(self) -> float:
        return float(np.count_nonzero(self.kind == Kind.SLIPPING)) * BLOCK_NS / NS_PER_S


def samples_of(columns: Columns, longest_gap_ns: int = LONGEST_GAP_NS) -> LockupSamples | None:
    """Return the signals at common times; None where one of them is missing."""
    if any(signal not in columns or len(columns[signal].t_ns) < LEAST_SAMPLES for signal in LOCKUP_SIGNALS):
        return None
    first = max(int(columns[signal].t_ns[0]) for signal in LOCKUP_SIGNALS)
    last = min(int(columns[signal].t_ns[-1]) for signal in LOCKUP_SIGNALS)
    speed = columns[Signal.ENGINE_SPEED].between(first, last + 1)
    if len(speed.t_ns) < LEAST_SAMPLES:
        return None
    at_s = (speed.t_ns - first) / NS_PER_S

    def there(signal: Signal) -> FloatArray:
        series = columns[signal]
        return np.interp(at_s, (series.t_ns - first) / NS_PER_S, series.value)

    is_bridged = np.zeros(len(at_s), np.bool_)
    for signal in LOCKUP_SIGNALS:
        t_ns = columns[signal].t_ns
        after = np.clip(t_ns.searchsorted(speed.t_ns), 1, len(t_ns) - 1)
        is_bridged |= t_ns[after] - t_ns[after - 1] > longest_gap_ns

    sump = columns.get(Signal.SUMP_TEMPERATURE)
    has_oil = sump is not None and len(sump.t_ns) > 0  # a message may stop amid a drive
    return LockupSamples(
        t_ns=speed.t_ns,
        engine_rad_s=speed.value,
        turbine_rad_s=there(Signal.TURBINE_SPEED),
        torque_nm=there(Signal.ENGINE_TORQUE),
        pressure_pa=there(Signal.LOCKUP_PRESSURE),
        oil_k=there(Signal.SUMP_TEMPERATURE) if has_oil else np.full(len(at_s), OIL_K),
        is_bridged=is_bridged,
    )


OIL_K: Final = 353.15  # at which friction is stated


def torque_per_pa(calibration: Calibration) -> float:
    """Return torque of the lock-up clutch over friction coefficient and pressure beyond its touch point [N m/Pa]."""
    law = film_law(calibration.clutches[0])
    return float(contact_torques_nm(1.0, 1.0, law.piston_area_m2 / law.lining_area_m2, law.contact_factor_m3))


def weight_at_40_rpm(calibration: Calibration) -> float:
    """Return the share of mu_S in friction at 40 rpm."""
    law = friction_law(calibration.clutches[0].friction)
    return float(stribeck_weights(np.array(MICRO_SLIP_RAD_S), law))


def cut(samples: LockupSamples, calibration: Calibration, converter: Converter) -> Blocks:
    """Return the blocks of a stretch in which the clutch is open or slips, and nothing changes quickly."""
    clutch = calibration.clutches[0]
    law, reference = friction_law(clutch.friction), clutch.friction
    per_pa, touch_pa = torque_per_pa(calibration), clutch.touch_pressure_pa
    inertia = calibration.input_side.engine_inertia_kg_m2 + converter.impeller_inertia_kg_m2
    share = weight_at_40_rpm(calibration)
    mu_40 = reference.mu_c + share * (reference.mu_s - reference.mu_c)

    place = samples.t_ns // BLOCK_NS
    begins = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
    sizes = np.diff(begins, append=len(place))

    def mean(values: FloatArray) -> FloatArray:
        means: FloatArray = np.add.reduceat(values, begins) / sizes
        return means

    slip, engine = samples.slip_rad_s, samples.engine_rad_s
    at_s = (samples.t_ns - samples.t_ns[0]) / NS_PER_S
    away_s = at_s - np.repeat(mean(at_s), sizes)
    scale_s2 = np.maximum(mean(away_s**2), 1e-12)
    rate, slip_rate = mean(away_s * engine) / scale_s2, mean(away_s * slip) / scale_s2
    pressed_pa = samples.pressure_pa - touch_pa
    pressures = mean(pressed_pa)
    steady = (
        (sizes >= LEAST_SAMPLES)
        & ~np.logical_or.reduceat(samples.is_bridged, begins)
        & (np.abs(rate) < MOST_RATE_RAD_S2)
        & (np.abs(slip_rate) < MOST_SLIP_RATE_RAD_S2)
        & (np.abs(mean(away_s * pressed_pa) / scale_s2) * BLOCK_NS / NS_PER_S < MOST_PRESSURE_STEP_PA)
        & (mean(engine) > LEAST_TURNING_RAD_S)
    )
    # Slip that swings down to lock sticks in between, where friction tells nothing.
    swing = slip - np.repeat(mean(slip), sizes) - away_s * np.repeat(slip_rate, sizes)
    noise = calibration.noise.engine_speed_rad_s**2 + calibration.noise.input_speed_rad_s**2
    steady &= mean(swing**2) - noise < (MOST_SWING_RATIO * mean(slip)) ** 2
    slips = steady & (pressures > LEAST_PRESSURE_PA) & (mean(slip) > LEAST_SLIP_RAD_S) & (mean(slip) < MOST_SLIP_RAD_S)
    is_open = (
        steady
        & (np.maximum.reduceat(pressed_pa, begins) < -LEAST_PRESSURE_PA / 2.0)
        & (mean(samples.turbine_rad_s) > 0.0)
    )
    kind = np.where(slips, Kind.SLIPPING, np.where(is_open, Kind.OPEN, Kind.OTHER))

    normal_nm = per_pa * np.maximum(pressed_pa, 0.0)
    weight = stribeck_weights(slip, law)
    warmth = (samples.oil_k - OIL_K) * mu_40
    is_on = np.repeat(kind == Kind.SLIPPING, sizes)
    ratio = np.clip(samples.turbine_rad_s / np.maximum(engine, 1.0), 0.0, 1.0)
    rows = np.empty((len(begins), PARAMETER_START + len(converter.speed_ratios)))
    rows[:, 0] = mean(normal_nm * is_on)
    rows[:, _MARGIN] = mean(normal_nm * (share - weight) * is_on)
    rows[:, 2] = mean(normal_nm * warmth * is_on)
    rows[:, 3] = 1.0
    rows[:, 4] = -per_pa * mu_40 * mean(is_on.astype(float))
    rows[:, 5] = inertia * rate
    for knot, hat in enumerate(np.eye(len(converter.speed_ratios))):
        capacity = np.interp(ratio, converter.speed_ratios, hat * np.array(converter.capacities_nm_s2))
        rows[:, PARAMETER_START + knot] = mean(capacity * engine**2)
    by_type = rows[:, PARAMETER_START:].sum(axis=1)
    torque_nm = mean(samples.torque_nm) - inertia * rate - by_type
    is_used = kind != Kind.OTHER
    heat_w = normal_nm * (mu_40 * slip) * is_on
    return Blocks(
        place=place[begins][is_used],
        kind=kind[is_used],
        rows=rows[is_used],
        torque_nm=torque_nm[is_used],
        clutch_nm=mu_40 * rows[is_used, 0],
        energy_j=float((heat_w[1:] * np.diff(at_s)).sum()),
    )


def is_slipping(pressed_pa: FloatArray, slip_rad_s: FloatArray) -> BoolArray:
    """Return of samples whether the clutch carries while it slips."""
    slips: BoolArray = (
        (pressed_pa > LEAST_PRESSURE_PA) & (slip_rad_s > LEAST_SLIP_RAD_S) & (slip_rad_s < MOST_SLIP_RAD_S)
    )
    return slips


ALGORITHM_VERSION: Final = "lockup-balance-1"
STATE_FORMAT: Final = 1  # of what is stored
LAG_COUNT: Final = 24  # twelve seconds: what lasts longer is an offset of its own
EXPECTED_CORRELATION: Final = 0.8  # from block to block, before residuals show it; a torque model errs for seconds
EXPECTED_WEIGHT: Final = 60.0  # blocks that the expectation counts for
BLOCK_STD_NM: Final = 2.0  # likewise, of one block
LOAD_RATIO: Final = 0.01  # of the clutch's torque: pressure, heat and lining differ from minute to minute
UNKNOWN_STD: Final = 0.1  # of friction
LEAST_STD: Final = 1e-6  # of what a description calls certain: a covariance must have an inverse
SHAPE_RATIO: Final = 0.03  # of capacities, each by itself
EVENT_OFFSET_NM: Final = 0.7  # per stretch: what else the engine drives
EVENT_FRICTION_STD: Final = 1e-4  # per stretch: heat and running-in
EVENT_MARGIN_STD: Final = 5e-5  # likewise, of mu_C - mu_S
BASELINE_COUNT: Final = 15  # stretches
MISFIT_RATIO: Final = 25.0  # of the variance of blocks to that expected: no converter behind such torque
CONTRADICTION: Final = 9.2  # squared distance of two numbers: 1 % by chance, three in a row 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class LockupBaseline:
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
    baseline: LockupBaseline | None = None
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
        stds = (
            UNKNOWN_STD,
            UNKNOWN_STD,
            spread.friction_temperature_1_k,
            spread.torque_offset_nm,
            math.hypot(spread.pressure_zero_pa, spread.touch_pressure_pa),
            math.hypot(spread.engine_inertia_ratio, spread.torque_gain_ratio),
        )
        covariance[np.arange(len(stds)), np.arange(len(stds))] = np.maximum(stds, LEAST_STD) ** 2
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
        now = LockupBaseline(
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
        stored = _Stored(**{name: getattr(self, name) for name in _Stored.__dataclass_fields__})
        return {"format": STATE_FORMAT, **records.to_plain(stored)}

    @classmethod
    def from_json(cls, table: Mapping[str, object], calibration: Calibration) -> Self:
        """Rebuild a state saved by `to_json` under the same calibration; raises ValueError if it is none."""
        blank = cls.fresh(calibration)
        if table.get("format") != STATE_FORMAT:
            raise ValueError(f"running state of format {table.get('format')!r}, expected {STATE_FORMAT}")
        try:
            stored = records.from_plain({key: value for key, value in table.items() if key != "format"}, _Stored)
        except (TypeError, ValueError) as exc:
            raise ValueError(f"not a running state: {exc}") from exc
        for name in ("mean", "covariance", "lag_sums", "lag_counts"):
            value = getattr(stored, name)
            if value.shape != getattr(blank, name).shape or not np.all(np.isfinite(value)):
                raise ValueError(f"not a running state: bad {name}")
        return replace(blank, **{name: getattr(stored, name) for name in _Stored.__dataclass_fields__})


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
    baseline: LockupBaseline | None
