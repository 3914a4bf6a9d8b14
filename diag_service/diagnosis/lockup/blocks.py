"""A stretch of a drive in blocks of half a second: what drives the engine's side in each, and what takes it away.

In a block where nothing changes quickly the torque of the engine, less what turns itself faster, goes through the
converter and through its lock-up clutch. All of it is linear in what is asked for, so a block is a row of numbers.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from clutch_model.calibration import Calibration, Converter
from clutch_model.pack import contact_torques_nm, film_law, friction_law, stribeck_weights
from clutch_model.units import NS_PER_S
from diag_service.diagnosis.columns import LOCKUP_SIGNALS, Columns, Signal

MICRO_SLIP_RAD_S: Final = 40.0 * np.pi / 30.0  # where friction is told: 40 rpm, amid what controllers hold
BLOCK_NS: Final = NS_PER_S // 2
LONGEST_GAP_NS: Final = NS_PER_S // 10  # between samples that a line may join
LEAST_SAMPLES: Final = 10  # of each signal in a block: 20 a second
LEAST_SLIP_RAD_S: Final = 0.8  # of the mean; closer to lock a tooth decides
MOST_SLIP_RAD_S: Final = 30.0
MOST_RATE_RAD_S2: Final = 40.0  # of the engine: faster, late torque is no balance
MOST_SLIP_RATE_RAD_S2: Final = 6.0
MOST_PRESSURE_STEP_PA: Final = 0.4e5  # within a block
LEAST_PRESSURE_PA: Final = 0.3e5  # beyond touch, for a clutch that carries; as far below it is open
MOST_SWING_RATIO: Final = 0.25  # root mean square of the slip, over its mean
LEAST_TURNING_RAD_S: Final = 60.0  # of the engine
_MARGIN: Final = 1  # place of what else is told below
FRICTION_COUNT: Final = 2  # friction at 40 rpm, and mu_C - mu_S
OTHERS: Final = ("temperature", "offset", "pressure", "inertia")  # then the capacities at the converter's speed ratios
PARAMETER_START: Final = FRICTION_COUNT + len(OTHERS)


class Kind(IntEnum):
    """What the lock-up clutch does in a block."""

    OTHER = 0
    OPEN = 1
    SLIPPING = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
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


def samples_of(columns: Columns) -> Samples | None:
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
        one = columns[signal]
        return np.interp(at_s, (one.t_ns - first) / NS_PER_S, one.value)

    is_bridged = np.zeros(len(at_s), np.bool_)
    for signal in LOCKUP_SIGNALS:
        t_ns = columns[signal].t_ns
        after = np.clip(t_ns.searchsorted(speed.t_ns), 1, len(t_ns) - 1)
        is_bridged |= t_ns[after] - t_ns[after - 1] > LONGEST_GAP_NS

    sump = columns.get(Signal.SUMP_TEMPERATURE)
    is_told = sump is not None and len(sump.t_ns) > 0  # a message may stop amid a drive
    return Samples(
        t_ns=speed.t_ns,
        engine_rad_s=speed.value,
        turbine_rad_s=there(Signal.TURBINE_SPEED),
        torque_nm=there(Signal.ENGINE_TORQUE),
        pressure_pa=there(Signal.LOCKUP_PRESSURE),
        oil_k=there(Signal.SUMP_TEMPERATURE) if is_told else np.full(len(at_s), OIL_K),
        is_bridged=is_bridged,
    )


OIL_K: Final = 353.15  # to which friction is told


def torque_per_pa(calibration: Calibration) -> float:
    """Return torque of the lock-up clutch over friction coefficient and pressure beyond its touch point [N m/Pa]."""
    law = film_law(calibration.clutches[0])
    return float(contact_torques_nm(1.0, 1.0, law.piston_area_m2 / law.lining_area_m2, law.contact_factor_m3))


def weight_at_40_rpm(calibration: Calibration) -> float:
    """Return the share of mu_S in friction at 40 rpm."""
    law = friction_law(calibration.clutches[0].friction)
    return float(stribeck_weights(np.array(MICRO_SLIP_RAD_S), law))


def cut(samples: Samples, calibration: Calibration, converter: Converter) -> Blocks:
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
        found: FloatArray = np.add.reduceat(values, begins) / sizes
        return found

    def spread(values: FloatArray) -> FloatArray:
        found: FloatArray = np.maximum.reduceat(values, begins) - np.minimum.reduceat(values, begins)
        return found

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
    told = kind != Kind.OTHER
    heat_w = normal_nm * (mu_40 * slip) * is_on
    return Blocks(
        place=place[begins][told],
        kind=kind[told],
        rows=rows[told],
        torque_nm=torque_nm[told],
        clutch_nm=mu_40 * rows[told, 0],
        energy_j=float((heat_w[1:] * np.diff(at_s)).sum()),
    )


def is_slipping(pressed_pa: FloatArray, slip_rad_s: FloatArray) -> BoolArray:
    """Return of samples whether the clutch carries while it slips."""
    found: BoolArray = (
        (pressed_pa > LEAST_PRESSURE_PA) & (slip_rad_s > LEAST_SLIP_RAD_S) & (slip_rad_s < MOST_SLIP_RAD_S)
    )
    return found
