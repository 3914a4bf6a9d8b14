"""A drawn car with a torque converter and its lock-up clutch on a mixed drive, from first principles, as columns.

Engine and impeller, turbine behind the lock-up clutch, a soft driveline and the car: four speeds and a twist. Friction
follows a Stribeck curve, the controller holds a slip of some rad/s. Firing and a rough road swing the shafts, too.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numba
import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import lfilter

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series
from clutch_model.calibration import Calibration, shipped_calibration
from clutch_model.units import NS_PER_S
from diag_service.diagnosis.columns import ColumnBatch, Signal

FLUIDS: Final = {"new": (1.0, 1.0), "aged": (0.95, 1.05), "worn": (0.85, 1.15)}  # of mu_C and mu_S
STEP_S: Final = 1e-3
SAMPLE_STEPS: Final = 10
RATIOS: Final = np.array([4.7, 3.13, 2.1, 1.67, 1.29, 1.0, 0.84]) * 3.2  # of gears, engine over wheels


@dataclass(frozen=True, slots=True, kw_only=True)
class ConverterCar:
    """What is special about one car; the defaults are as the calibration has it."""

    mu_c: float = 0.14
    mu_s: float = 0.119
    stribeck_speed_rad_s: float = 6.0
    temperature_1_k: float = 0.0
    torque_gain: float = 1.0
    torque_offset_nm: float = 0.0
    torque_wander_nm: float = 1.5  # of the torque model, with a time constant of five seconds
    followed_ratio: float = 0.0  # of it and the offset, by the pressure that is fed forward
    area_ratio: float = 1.0
    zero_pa: float = 0.0
    touch_pa: float = 0.0
    inertia_ratio: float = 1.0
    capacity_ratios: tuple[float, ...] = (1.0,) * 10
    driveline_hz: float = 10.0
    driveline_damping: float = 0.04
    road_nm: float = 0.0
    firing_nm: float = 0.0  # of half an engine order, as one weak cylinder makes it

    def friction_at(self, slip_rad_s: float) -> float:
        return float(self.mu_c + (self.mu_s - self.mu_c) * np.exp(-slip_rad_s / self.stribeck_speed_rad_s))


def drawn_car(rng: np.random.Generator, fluid: str, calibration: Calibration) -> ConverterCar:
    """Return a car of the type with a fluid; half of them are on a rough road, half have a weak cylinder."""
    own, spread, (by_c, by_s) = calibration.clutches[0], calibration.uncertainty, FLUIDS[fluid]
    converter = calibration.converter
    if converter is None:
        raise ValueError("the type has no converter")
    common = rng.normal(1.0, converter.capacity_ratio)
    shape = tuple(common * (1.0 + 0.02 * rng.standard_normal(len(converter.speed_ratios))))
    return ConverterCar(
        mu_c=own.friction.mu_c * by_c * rng.normal(1.0, 0.02),
        mu_s=own.friction.mu_s * by_s * rng.normal(1.0, 0.02),
        stribeck_speed_rad_s=own.friction.stribeck_speed_rad_s * rng.normal(1.0, spread.stribeck_speed_ratio),
        temperature_1_k=rng.normal(0.0, spread.friction_temperature_1_k),
        torque_gain=rng.normal(1.0, spread.torque_gain_ratio),
        torque_offset_nm=rng.normal(0.0, spread.torque_offset_nm),
        torque_wander_nm=rng.uniform(0.5, 2.5),
        area_ratio=rng.normal(1.0, spread.piston_area_ratio),
        zero_pa=rng.normal(0.0, spread.pressure_zero_pa),
        touch_pa=rng.normal(0.0, spread.touch_pressure_pa),
        inertia_ratio=rng.normal(1.0, spread.engine_inertia_ratio),
        capacity_ratios=shape,
        driveline_hz=rng.uniform(7.0, 13.0),
        driveline_damping=rng.uniform(0.02, 0.05),
        road_nm=rng.uniform(3.0, 12.0) if rng.random() < 0.5 else 0.0,
        firing_nm=rng.uniform(2.0, 8.0) if rng.random() < 0.5 else 0.0,
    )


class _Laws(NamedTuple):
    """Numbers of a car as the kernel takes them."""

    mu_c: float
    mu_s: float
    stribeck_rad_s: float
    per_k: float
    torque_per_pa: float  # of clutch torque over friction coefficient and pressure beyond touch
    touch_pa: float
    inertia_kg_m2: float
    turbine_kg_m2: float
    stiffness_nm_rad: float
    damping_nms_rad: float
    road_nm: float
    firing_nm: float


class DrivenCar(NamedTuple):
    """What a drive was: what the bus has of it, and what nobody is told."""

    columns: dict[Signal, Series]
    slips: BoolArray  # of each sample
    slip_rad_s: FloatArray
    true_shudder_s: float  # time in which the slip swung by more than half of itself


def drive(
    car: ConverterCar, rng: np.random.Generator, minutes: float, calibration: Calibration | None = None
) -> DrivenCar:
    """Return a mixed drive: town and country, cold at first."""
    calibration = calibration or shipped_calibration("lockup")
    converter, clutch, noise = calibration.converter, calibration.clutches[0], calibration.noise
    if converter is None:
        raise ValueError("the type has no converter")
    count = int(minutes * 60.0 / STEP_S)
    wanted = _wanted_speeds_m_s(rng, count)
    fine = np.linspace(0.0, 1.0, 401)
    capacity = PchipInterpolator(converter.speed_ratios, np.array(converter.capacities_nm_s2) * car.capacity_ratios)(
        fine
    )
    gain = PchipInterpolator(converter.speed_ratios, converter.torque_ratios)(fine)
    faces = clutch.geometry.faces
    per_pa = faces.contact_factor_m3 / faces.lining_area_m2 * clutch.geometry.piston_area_m2 * car.area_ratio
    inertia = calibration.input_side.engine_inertia_kg_m2 + converter.impeller_inertia_kg_m2
    turbine = converter.turbine_inertia_kg_m2 + 0.04
    stiffness = turbine * (2.0 * np.pi * car.driveline_hz) ** 2
    laws = _Laws(
        mu_c=car.mu_c,
        mu_s=car.mu_s,
        stribeck_rad_s=car.stribeck_speed_rad_s,
        per_k=car.temperature_1_k,
        torque_per_pa=per_pa,
        touch_pa=clutch.touch_pressure_pa + car.touch_pa,
        inertia_kg_m2=inertia * car.inertia_ratio,
        turbine_kg_m2=turbine,
        stiffness_nm_rad=stiffness,
        damping_nms_rad=2.0 * car.driveline_damping * np.sqrt(stiffness * turbine),
        road_nm=car.road_nm,
        firing_nm=car.firing_nm,
    )
    targets = np.repeat(rng.uniform(20.0, 60.0, count // 8000 + 1) * np.pi / 30.0, 8000)[:count]
    oil_k = 363.15 - (363.15 - 313.15) * np.exp(-np.arange(count) * STEP_S / 500.0)
    out = np.empty((count // SAMPLE_STEPS, 8))
    chance, size = rng.standard_normal(count), len(out)
    wander = _wander(rng, size, car.torque_wander_nm, 5.0)
    misread = np.repeat(car.followed_ratio * (car.torque_offset_nm + wander), SAMPLE_STEPS)
    _simulate(laws, capacity, gain, wanted, targets, oil_k, chance, misread, RATIOS, out)
    engine, turbine_speed, torque, pressure, gear, output, mode, command = out.T
    t_ns = np.arange(1, size + 1) * round(STEP_S * SAMPLE_STEPS * NS_PER_S)
    late = np.concatenate((torque[:2], torque[:-2]))
    read = {
        Signal.ENGINE_SPEED: engine + rng.normal(0.0, noise.engine_speed_rad_s, size),
        Signal.TURBINE_SPEED: turbine_speed + rng.normal(0.0, noise.input_speed_rad_s, size),
        Signal.ENGINE_TORQUE: car.torque_gain * late + car.torque_offset_nm + wander
        + rng.normal(0.0, noise.engine_torque_nm, size),
        Signal.LOCKUP_PRESSURE: pressure + car.zero_pa + rng.normal(0.0, noise.pressure_pa, size),
        Signal.LOCKUP_PRESSURE_COMMAND: command,
        Signal.LOCKUP_SLIP_COMMAND: np.where(mode > 0.0, targets[::SAMPLE_STEPS][:size], 0.0),
    }  # fmt: skip
    columns = {signal: _series(t_ns, value, 10) for signal, value in read.items()}
    columns[Signal.CURRENT_GEAR] = _series(t_ns[::2], gear[::2], 20)
    columns[Signal.OUTPUT_SPEED] = _series(t_ns, output + rng.normal(0.0, noise.input_speed_rad_s, size), 10)
    columns[Signal.SUMP_TEMPERATURE] = _series(t_ns[::100], np.round(oil_k[::1000]), 1000)
    slip = engine - turbine_speed
    slips = (mode >= 1.0) & (slip > 0.5)
    return DrivenCar(columns=columns, slips=slips, slip_rad_s=slip, true_shudder_s=_shudder_s(slip, mode == 2.0))


def _shudder_s(slip_rad_s: FloatArray, holds: BoolArray) -> float:
    """Return in how many seconds of held slip it swings by more than half of its mean, about it."""
    whole = len(slip_rad_s) // 100 * 100
    rows, held = slip_rad_s[:whole].reshape(-1, 100), holds[:whole].reshape(-1, 100).all(axis=1)
    means = rows.mean(axis=1)
    trend = np.linspace(-0.5, 0.5, 100)
    rest = rows - means[:, None] - (rows @ trend / (trend @ trend))[:, None] * trend
    swings = rest.std(axis=1) * np.sqrt(2.0) > 0.5 * np.abs(means)
    return float(np.count_nonzero(held & swings & (means > 1.0)))


def _series(t_ns: Int64Array, value: FloatArray, period_ms: int) -> Series:
    return Series(t_ns=t_ns, sequence=np.arange(len(t_ns)), value=value, period_ns=period_ms * 1_000_000)


def _wander(rng: np.random.Generator, size: int, std: float, time_s: float) -> FloatArray:
    keep = float(np.exp(-STEP_S * SAMPLE_STEPS / time_s))
    found: FloatArray = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(size)) * std
    return found


def _wanted_speeds_m_s(rng: np.random.Generator, count: int) -> FloatArray:
    """Return a trace of wanted speeds: stretches of 20 to 60 s, town, country and road, now and then a stop."""
    wanted, at, speed = np.empty(count), 0, 0.0
    while at < count:
        steps = int(rng.uniform(20.0, 60.0) / STEP_S)
        goal = 0.0 if rng.random() < 0.15 else rng.uniform(8.0, 30.0)
        rate = rng.uniform(0.4, 1.6) * STEP_S
        ramp = speed + np.clip(np.arange(steps) * rate, 0.0, abs(goal - speed)) * np.sign(goal - speed)
        wanted[at : at + steps] = ramp[: count - at] + 0.4 * np.sin(np.arange(steps) * STEP_S * 0.5)[: count - at]
        at, speed = at + steps, float(ramp[-1])
    return np.maximum(wanted, 0.0)


@numba.njit(cache=True)
def _simulate(  # noqa: PLR0915 - the equations of one step
    laws: _Laws,
    capacity: FloatArray,
    gain: FloatArray,
    wanted_m_s: FloatArray,
    target_rad_s: FloatArray,
    oil_k: FloatArray,
    chance: FloatArray,
    misread_nm: FloatArray,
    ratios: FloatArray,
    out: FloatArray,
) -> None:
    dt, inner = 1e-3, 4
    engine, turbine, twist, car_m_s, torque, pressure, trim_pa = 80.0, 0.0, 0.0, 0.0, 30.0, 0.0, 0.0
    pump = 0.0
    gear, since, held_s, mode, rough, angle = 0, 0.0, 0.0, 0, 0.0, 0.0
    wheel_m, mass = 0.32, 1650.0
    fine = len(capacity) - 1
    for step in range(len(wanted_m_s)):
        since += dt
        v = car_m_s
        if since > 2.0 and gear < len(ratios) - 1 and turbine > 175.0 + 0.3 * max(torque, 0.0):
            gear, since = gear + 1, 0.0
        elif since > 2.0 and gear > 0 and turbine < 105.0:
            gear, since = gear - 1, 0.0
        ratio = ratios[gear]
        force = min(max(2500.0 * (wanted_m_s[step] - v) + 150.0 + 0.4 * v * v, -3000.0), 6000.0)
        asked = min(max(force * wheel_m / ratio, -25.0), 330.0) if wanted_m_s[step] > 0.2 or v > 1.0 else 15.0
        if engine < 75.0:
            asked = max(asked, 20.0 + 3.0 * (75.0 - engine))
        torque += dt / 0.15 * (asked - torque)
        slip = engine - turbine
        is_able = gear >= 2 and turbine > 100.0 and torque > 15.0 and since > 1.0
        if not is_able:
            mode, held_s, command, trim_pa = 0, 0.0, 0.0, 0.0
        else:
            mode = 2 if held_s > 3.0 else 1
            goal = target_rad_s[step] + max(0.0, 25.0 * (1.0 - held_s / 1.5))
            held_s += dt
            carried = max(torque + misread_nm[step], 5.0)
            base = laws.touch_pa + carried / (0.13 * laws.torque_per_pa)
            trim_pa = min(max(trim_pa + dt * 6e3 * (slip - goal), -1.5e5), 3e5)
            command = max(base + trim_pa + 3e3 * min(max(slip - goal, -10.0), 10.0), 0.0) * min(1.0, held_s / 0.3)
        pressure += dt / 0.03 * (command - pressure)
        rough += dt / 0.02 * (-rough) + laws.road_nm * np.sqrt(2.0 * dt / 0.02) * chance[step]
        normal = max(0.0, pressure - laws.touch_pa) * laws.torque_per_pa
        warm = 1.0 + laws.per_k * (oil_k[step] - 353.15)
        inertia_v = mass * wheel_m * wheel_m / (ratio * ratio)
        brake = 6000.0 if wanted_m_s[step] < v - 0.5 and torque < 0.0 else 0.0
        for _ in range(inner):
            h = dt / inner
            slip = engine - turbine
            nu = min(max(turbine / max(engine, 1.0), 0.0), 1.0)
            at = nu * fine
            low = min(int(at), fine - 1)
            share = at - low
            cap = capacity[low] + share * (capacity[low + 1] - capacity[low])
            mult = gain[low] + share * (gain[low + 1] - gain[low])
            pump += h / 0.05 * (cap * engine * engine - pump)  # the oil in the converter is heavy
            a = abs(slip)
            mu = (laws.mu_c + (laws.mu_s - laws.mu_c) * np.exp(-a / laws.stribeck_rad_s)) * warm
            friction = normal * mu * np.tanh(slip / 0.15)
            angle += h * engine
            firing = laws.firing_nm * np.sin(0.5 * angle)
            spin = turbine - v * ratio / wheel_m
            shaft = laws.stiffness_nm_rad * twist + laws.damping_nms_rad * spin
            # The lock-up friction is stiff near zero slip: semi-implicit in the slip.
            stiff = normal * mu / 0.15 * (1.0 - np.tanh(slip / 0.15) ** 2)
            de = (torque + firing - pump - friction) / laws.inertia_kg_m2
            dw = (pump * mult + friction - shaft) / laws.turbine_kg_m2
            implicit = 1.0 + h * stiff * (1.0 / laws.inertia_kg_m2 + 1.0 / laws.turbine_kg_m2)
            change = (de - dw) * h / implicit
            mean = (laws.inertia_kg_m2 * de + laws.turbine_kg_m2 * dw) / (laws.inertia_kg_m2 + laws.turbine_kg_m2) * h
            total = laws.inertia_kg_m2 + laws.turbine_kg_m2
            engine += mean + change * laws.turbine_kg_m2 / total
            turbine += mean - change * laws.inertia_kg_m2 / total
            twist += h * spin
            load = (150.0 + 0.4 * v * v + brake) * wheel_m / ratio if v > 0.05 else 0.0
            v += h * (shaft - load + rough) / inertia_v * wheel_m / ratio
            v = max(v, 0.0)
            turbine = max(turbine, 0.0)
        car_m_s = v
        if (step + 1) % 10 == 0:
            row = step // 10
            out[row, 0] = engine
            out[row, 1] = turbine
            out[row, 2] = torque
            out[row, 3] = pressure
            out[row, 4] = gear + 1
            out[row, 5] = v / wheel_m
            out[row, 6] = mode
            out[row, 7] = command


def batches(columns: dict[Signal, Series], span_s: float = 10.0) -> list[ColumnBatch]:
    """Return columns cut into pieces, as a decoder hands them on."""
    end_ns = max(int(one.t_ns[-1]) for one in columns.values()) + 1
    step_ns = round(span_s * NS_PER_S)
    return [
        ColumnBatch(
            columns={signal: one.between(start, start + step_ns) for signal, one in columns.items()},
            watermark_ns=min(start + step_ns, end_ns),
        )
        for start in range(0, end_ns, step_ns)
    ]
