"""The motion of the driveline in a whole drive, given all its readings: a Kalman filter forward, a smoother backward.

The backward pass is that of Rauch and others (RTS) in the form of Bryson and Frazier: it needs no inverse of a
covariance, so states that hardly any noise drives do no harm.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from studies.full_estimator.motion import Forcing, MotionLaw, State
from studies.full_estimator.signals import BoolArray, FullSignals
from canlog.arrays import FloatArray
from canlog.jit import kernel

SIZE = len(State)
LOCK_STD_RAD_S = 0.02  # what slip a locked clutch still shows, and the discretisation
# Wander per root of a second while both shafts are in gear, and while one is not and its synchroniser acts.
COUPLED_WANDER = (0.03, 0.01, 0.0, 0.0, 0.0, 100.0)
FREE_WANDER = (100.0, 10.0, 0.0, 0.0, 0.0, 300.0)
START_STD = (20.0, 5.0, 0.1, 5.0, 1.0, 2000.0)
START_SAMPLES = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """What the smoother says."""

    states: FloatArray  # (n, 6)
    slip_rad_s: FloatArray  # (2, n)
    slip_std_rad_s: FloatArray  # (2, n)


class Readings(NamedTuple):
    """All that is known of every sample, a row each."""

    value: FloatArray  # (n, 5), speeds of hub and input shafts, and the twist of the shafts
    ratio: FloatArray  # (n, 2), of the gears that are engaged; 0: none
    is_locked: BoolArray  # (n, 2)
    drive: FloatArray  # (n, 6), what turns hub and differential
    wander: FloatArray  # (n, 6), variance that a period adds
    about: FloatArray  # (n, 6), where the tyre's law is linearised; NaN: at the filter's own state
    variances: FloatArray  # (4,), of the speeds and of the slip of a locked clutch


def smooth(
    signals: FullSignals, forced: Forcing, law: MotionLaw, is_locked: BoolArray, about: FloatArray | None = None
) -> Motion:
    """Return the motion given every reading.

    Parameters
    ----------
    is_locked : (2, n) array of bool
        Where each clutch is known to be locked.
    about : (n, 6) array, optional
        States about which the tyre's law is linearised; without them the filter's own.
    """
    count = len(signals.hub_rad_s)
    states, slip_std = np.empty((count, SIZE)), np.empty((2, count))
    own = np.full((count, SIZE), np.nan) if about is None else about
    twist_rad_s = np.stack([one.rate_rad_s for one in forced.twist])
    drive = np.stack(
        [
            forced.hub_nm,
            forced.hub_share_kg_m2,
            forced.hub_drag_nms_rad,
            forced.diff_nm,
            forced.diff_inertia_kg_m2,
            forced.diff_drag_nms_rad,
        ],
        axis=1,
    )
    readings = np.column_stack((signals.hub_rad_s, (signals.input_rad_s - twist_rad_s).T, twist_rad_s.T))
    wander = np.where(forced.is_coupled[:, None], COUPLED_WANDER, FREE_WANDER) ** 2 * signals.period_s
    seen = Readings(
        value=readings,
        ratio=np.ascontiguousarray(forced.ratio.T),
        is_locked=np.ascontiguousarray(is_locked.T),
        drive=drive,
        wander=wander,
        about=own,
        variances=np.append(signals.speed_std_rad_s, LOCK_STD_RAD_S) ** 2,
    )
    _smooth(seen, _start(signals, forced, law), np.diag(np.square(START_STD)), signals.period_s, law, states, slip_std)
    slip = states[:, State.HUB_SPEED] - forced.ratio * states[:, State.DIFF_SPEED] - twist_rad_s
    return Motion(states=states, slip_rad_s=slip, slip_std_rad_s=slip_std)


def _start(signals: FullSignals, forced: Forcing, law: MotionLaw) -> FloatArray:
    """Return a state to start from: rolling, the half shafts carrying what the gears do."""
    few = slice(0, START_SAMPLES)
    m = int(np.argmax(forced.ratio[:, 0] > 0.0))
    diff_rad_s = float(np.mean(signals.input_rad_s[m, few])) / forced.ratio[m, 0]
    start = np.zeros(SIZE)
    start[State.HUB_SPEED] = np.mean(signals.hub_rad_s[few])
    start[[State.DIFF_SPEED, State.WHEEL_SPEED]] = diff_rad_s
    start[State.OUTPUT_TWIST] = forced.diff_nm[0] / law.output_stiffness_nm_rad
    start[State.VEHICLE_SPEED] = diff_rad_s * law.wheel_radius_m
    return start


@kernel
def rates(
    drive: FloatArray, wheel_rad_s: float, vehicle_m_s: float, law: MotionLaw, matrix: FloatArray, offset: FloatArray
) -> None:
    """Fill ``matrix`` (6, 6) and ``offset`` (6,) with ``x' = matrix @ x + offset``, the tyre linearised.

    ``drive`` holds (hub_nm, hub_share, hub_drag, diff_nm, diff_inertia, diff_drag).
    """
    matrix[:] = 0.0
    offset[:] = 0.0
    inertia = drive[4]
    matrix[1, 1] = -(drive[5] + law.output_shaft_damping_nms_rad) / inertia
    matrix[1, 2] = -law.output_stiffness_nm_rad / inertia
    matrix[1, 3] = law.output_shaft_damping_nms_rad / inertia
    offset[1] = drive[3] / inertia
    matrix[0] = -drive[1] / law.hub_inertia_kg_m2 * matrix[1]
    matrix[0, 0] -= law.hub_damping_nms_rad / law.hub_inertia_kg_m2
    matrix[0, 1] -= drive[2] / law.hub_inertia_kg_m2
    offset[0] = (drive[0] - drive[1] * offset[1]) / law.hub_inertia_kg_m2
    matrix[2, 1] = 1.0
    matrix[2, 3] = -1.0
    speed = max(vehicle_m_s, 1.0)
    reach = law.tyre_stiffness_n * (law.wheel_radius_m * wheel_rad_s - vehicle_m_s) / (speed * law.tyre_grip_n)
    share = math.tanh(reach)
    steepness_n = law.tyre_stiffness_n * (1.0 - share * share)
    by_wheel = steepness_n * law.wheel_radius_m / speed
    by_vehicle = -steepness_n * law.wheel_radius_m * wheel_rad_s / (speed * speed)
    rest_n = law.tyre_grip_n * share - by_wheel * wheel_rad_s - by_vehicle * vehicle_m_s
    radius, wheel_inertia = law.wheel_radius_m, law.wheel_inertia_kg_m2
    matrix[3, 1] = law.output_shaft_damping_nms_rad / wheel_inertia
    matrix[3, 2] = law.output_stiffness_nm_rad / wheel_inertia
    drag = law.output_shaft_damping_nms_rad + law.wheel_damping_nms_rad + radius * by_wheel
    matrix[3, 3] = -drag / wheel_inertia
    matrix[3, 4] = -radius * by_vehicle / wheel_inertia
    offset[3] = -radius * rest_n / wheel_inertia
    matrix[4, 3] = by_wheel / law.mass_kg
    matrix[4, 4] = by_vehicle / law.mass_kg
    matrix[4, 5] = -1.0 / law.mass_kg
    offset[4] = rest_n / law.mass_kg


@kernel
def _observe(k: int, seen: Readings, rows: FloatArray, values: FloatArray, noise: FloatArray) -> int:
    """Fill in what sample k says, ``value = row @ x + noise``; return how many things."""
    rows[:] = 0.0
    rows[0, 0] = 1.0
    values[0] = seen.value[k, 0]
    noise[0] = seen.variances[0]
    count = 1
    for m in range(2):
        if seen.ratio[k, m] > 0.0:
            rows[count, 1] = seen.ratio[k, m]
            values[count] = seen.value[k, 1 + m]
            noise[count] = seen.variances[1 + m]
            count += 1
            if seen.is_locked[k, m]:
                rows[count, 0] = 1.0
                rows[count, 1] = -seen.ratio[k, m]
                values[count] = seen.value[k, 3 + m]
                noise[count] = seen.variances[3]
                count += 1
    return count


@kernel
def _update(
    mean: FloatArray,
    covariance: FloatArray,
    rows: FloatArray,
    values: FloatArray,
    noise: FloatArray,
    count: int,
    gains: FloatArray,
    innovations: FloatArray,
) -> None:
    """Update mean and covariance in place; keep each gain and, per its variance, each innovation."""
    for j in range(count):
        spread = covariance @ rows[j]
        variance = noise[j] + rows[j] @ spread
        innovation = values[j] - rows[j] @ mean
        for a in range(SIZE):
            gains[j, a] = spread[a] / variance
        innovations[j, 0] = innovation / variance
        innovations[j, 1] = 1.0 / variance
        for a in range(SIZE):
            mean[a] += gains[j, a] * innovation
            for b in range(SIZE):
                covariance[a, b] -= gains[j, a] * spread[b]


@kernel
def _smooth(
    seen: Readings,
    start: FloatArray,
    start_covariance: FloatArray,
    period_s: float,
    law: MotionLaw,
    states: FloatArray,
    slip_std: FloatArray,
) -> None:
    drive, ratio, about = seen.drive, seen.ratio, seen.about
    count = len(seen.value)
    means, covariances = np.empty((count, SIZE)), np.empty((count, SIZE, SIZE))
    steps = np.empty((count, SIZE, SIZE))
    rows, values, noise = np.zeros((5, SIZE)), np.zeros(5), np.zeros(5)
    gains, innovations = np.zeros((5, SIZE)), np.zeros((5, 2))
    matrix, offset = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    unit = np.eye(SIZE)
    mean, covariance = start.copy(), start_covariance.copy()
    for k in range(count):
        means[k] = mean
        covariances[k] = covariance
        seen_count = _observe(k, seen, rows, values, noise)
        _update(mean, covariance, rows, values, noise, seen_count, gains, innovations)
        if k + 1 == count:
            break
        point = mean if math.isnan(about[k, 0]) else about[k]
        rates(0.5 * (drive[k] + drive[k + 1]), point[3], point[4], law, matrix, offset)
        half = np.linalg.inv(unit - 0.5 * period_s * matrix)
        steps[k] = 2.0 * half - unit
        mean = steps[k] @ mean + period_s * (half @ offset)
        covariance = steps[k] @ covariance @ steps[k].T
        for a in range(SIZE):
            covariance[a, a] += seen.wander[k, a]
    pull, weight = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    for k in range(count - 1, -1, -1):
        if k + 1 < count:
            pull = steps[k].T @ pull
            weight = steps[k].T @ weight @ steps[k]
        seen_count = _observe(k, seen, rows, values, noise)
        _update(means[k].copy(), covariances[k].copy(), rows, values, noise, seen_count, gains, innovations)
        for j in range(seen_count - 1, -1, -1):
            _weigh(pull, weight, rows[j], gains[j], innovations[j])
        states[k] = means[k] - covariances[k] @ pull
        for m in range(2):
            row = np.zeros(SIZE)
            row[0] = 1.0
            row[1] = -ratio[k, m]
            spread = covariances[k] @ row
            slip_std[m, k] = math.sqrt(max(row @ spread - spread @ (weight @ spread), 0.0))


@kernel
def _weigh(pull: FloatArray, weight: FloatArray, row: FloatArray, gain: FloatArray, innovation: FloatArray) -> None:
    """Take one reading into the adjoint variables, in place."""
    along = gain @ pull
    for a in range(SIZE):
        pull[a] -= row[a] * (along + innovation[0])
    spread = weight @ gain
    twice = gain @ spread
    for a in range(SIZE):
        for b in range(SIZE):
            weight[a, b] += row[a] * row[b] * (twice + innovation[1]) - row[a] * spread[b] - spread[a] * row[b]
