"""Integration over a millisecond: fourth-order steps that stop where a clutch or a synchroniser may lock."""

import math
from typing import NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.jit import part
from ecu_emulator.plant import state as at
from ecu_emulator.plant.audit import SYNCHRONISERS, add_powers, restore_account, save_account, stored_energy_j
from ecu_emulator.plant.clutch import advance_clutch
from ecu_emulator.plant.driveline import ENGAGED, SYNCHRONISING, throttle_flow_kg_s
from ecu_emulator.plant.rates import PlantLaw, evaluate, lock_or_slip

_MILLISECOND_S = 1.0e-3
_MIN_STEP_S = 1.0e-9
_SETTLED = 1.0e-12  # a lag this close to its command has arrived
_EVENT_TRIES = 3
# An event step aims a little inside the lock band, so that rounding cannot miss it, and takes what is this near.
_EDGE = 0.98
_EDGE_LOW = 0.96


class Workspace(NamedTuple):
    """Arrays that the integration works in."""

    before: FloatArray  # (STATE_COUNT,), state at the start of a step
    predicted: FloatArray  # (STATE_COUNT,), state inside it
    slope1: FloatArray  # (OUTPUT_COUNT,), rates and torques at the start of a step
    slope: FloatArray  # (OUTPUT_COUNT,), and inside it
    account: FloatArray  # (3 * audit.ACCOUNT_COUNT,), or empty: no audit


class Machine(NamedTuple):
    """All arrays that change during a drive; the kernels write into them."""

    y: FloatArray  # (STATE_COUNT,)
    u: FloatArray  # (INPUT_COUNT,)
    modes: Int64Array  # (MODE_COUNT,)
    work: Workspace  # of the integration; its ``slope1`` holds rates and torques at the last row
    memory: FloatArray  # (tcu_data.MEMORY_COUNT,)
    sense: FloatArray  # (tcu_data.SENSE_COUNT,)
    commands: FloatArray  # (tcu_data.COMMAND_COUNT,)
    clock: Int64Array  # (1,), milliseconds since the start
    cycles: FloatArray  # (cycles, tcu_data.CYCLE_COLUMN_COUNT), read only


def workspace() -> Workspace:
    """Return empty arrays to work in."""
    return Workspace(
        before=np.zeros(at.STATE_COUNT),
        predicted=np.zeros(at.STATE_COUNT),
        slope1=np.zeros(at.OUTPUT_COUNT),
        slope=np.zeros(at.OUTPUT_COUNT),
        account=np.zeros(0),
    )


@part
def resolve_clutch_modes(y: FloatArray, u: FloatArray, modes: Int64Array, out: FloatArray, law: PlantLaw) -> None:
    """Evaluate the plant at ``y`` and bring the clutch modes into agreement with the torques."""
    evaluate(y, u, modes, out, law)
    if lock_or_slip(y, u, modes, out, law):
        evaluate(y, u, modes, out, law)


@part
def advance_fluids(y: FloatArray, u: FloatArray, dt_s: float, law: PlantLaw) -> None:
    """Advance what nothing mechanical acts back on: exact lags, the air flow with the throttle, oil, films."""
    engine = law.engine
    throttle_gap = y[at.THROTTLE] - u[at.THROTTLE_COMMAND]
    if throttle_gap != 0.0:
        throttle_gap *= math.exp(-dt_s / engine.throttle_lag_s)
        y[at.THROTTLE] = u[at.THROTTLE_COMMAND] + (throttle_gap if abs(throttle_gap) > _SETTLED else 0.0)
        u[at.AIR_FLOW] = throttle_flow_kg_s(y[at.THROTTLE], engine)
    spark_gap = y[at.SPARK] - u[at.SPARK_COMMAND]
    if spark_gap != 0.0:
        spark_gap *= math.exp(-dt_s / engine.spark_lag_s)
        y[at.SPARK] = u[at.SPARK_COMMAND] + (spark_gap if abs(spark_gap) > _SETTLED else 0.0)
    advance_clutch(y, u, 0, dt_s, law.clutches[0])
    advance_clutch(y, u, 1, dt_s, law.clutches[1])


@part
def copy(source: FloatArray, into: FloatArray) -> None:
    for i in range(at.STATE_COUNT):
        into[i] = source[i]


@part
def predict(y: FloatArray, before: FloatArray, slope: FloatArray, dt_s: float, into: FloatArray) -> None:
    """Put ``before`` moved along ``slope`` into ``into``, together with the present oil and film in ``y``."""
    for i in range(at.RATE_COUNT):
        into[i] = before[i] + dt_s * slope[i]
    for i in range(at.RATE_COUNT, at.STATE_COUNT):
        into[i] = y[i]


@part
def add_stage(y: FloatArray, slope: FloatArray, weight_s: float) -> None:
    """Add one stage of the Runge-Kutta step to the state."""
    for i in range(at.RATE_COUNT):
        y[i] += weight_s * slope[i]


@part
def step(machine: Machine, dt_s: float, law: PlantLaw) -> None:
    """Advance the state by ``dt_s`` with the modes frozen: classic Runge-Kutta, fluids in two halves."""
    y, u, modes = machine.y, machine.u, machine.modes
    before, predicted, slope1, slope, account = machine.work
    add_powers(account, dt_s / 6.0, before, u, modes, slope1, law)
    advance_fluids(y, u, 0.5 * dt_s, law)
    predict(y, before, slope1, 0.5 * dt_s, predicted)
    add_stage(y, slope1, dt_s / 6.0)
    evaluate(predicted, u, modes, slope, law)
    add_powers(account, dt_s / 3.0, predicted, u, modes, slope, law)
    predict(y, before, slope, 0.5 * dt_s, predicted)
    add_stage(y, slope, dt_s / 3.0)
    evaluate(predicted, u, modes, slope, law)
    add_powers(account, dt_s / 3.0, predicted, u, modes, slope, law)
    advance_fluids(y, u, 0.5 * dt_s, law)
    predict(y, before, slope, dt_s, predicted)
    add_stage(y, slope, dt_s / 3.0)
    evaluate(predicted, u, modes, slope, law)
    add_powers(account, dt_s / 6.0, predicted, u, modes, slope, law)
    add_stage(y, slope, dt_s / 6.0)


@part
def approach_fraction(old: float, change: float, new: float, band: float) -> float:
    """Return the share of a step after which a slip enters its band, 1 if it does not or stands at the edge.

    ``old`` and ``new`` are the slip before and after, ``change`` what its rate before would have made of it: a parabola
    goes through both with the slope at the first.
    """
    sign = 1.0 if old > 0.0 else -1.0
    old, change, new = sign * old, sign * change, sign * new
    if old <= band or new >= _EDGE_LOW * band:
        return 1.0
    above, below = old - _EDGE * band, new - _EDGE * band
    curve = below - above - change
    root = math.sqrt(max(change * change - 4.0 * curve * above, 0.0))
    return max(2.0 * above / (root - change), 0.0)


@part
def event_fraction(machine: Machine, dt_s: float, law: PlantLaw) -> float:
    """Return the share of the last step after which the first clutch or synchroniser may lock, else 1."""
    y, u, modes, before, slope = machine.y, machine.u, machine.modes, machine.work.before, machine.work.slope1
    fraction = 1.0
    for k in range(2):
        if modes[at.STICK + k] == 0:
            band = law.clutches[k].friction.lock_band_rad_s
            old, new = before[at.W_H] - before[at.W_L + k], y[at.W_H] - y[at.W_L + k]
            change = dt_s * (slope[at.W_H] - slope[at.W_L + k])
            fraction = min(fraction, approach_fraction(old, change, new, band))
        if modes[at.LINK + k] == SYNCHRONISING:
            ratio, band = u[at.RATIO + k], law.synchroniser.lock_slip_rad_s
            old, new = ratio * before[at.W_D] - before[at.W_G + k], ratio * y[at.W_D] - y[at.W_G + k]
            change = dt_s * (ratio * slope[at.W_D] - slope[at.W_G + k])
            fraction = min(fraction, approach_fraction(old, change, new, band))
    return fraction


@part
def close_synchronisers(machine: Machine, law: PlantLaw) -> None:
    """Engage a gear whose synchroniser has done its work, conserving momentum."""
    y, u, modes, account = machine.y, machine.u, machine.modes, machine.work.account
    for k in range(2):
        if modes[at.LINK + k] != SYNCHRONISING:
            continue
        ratio = u[at.RATIO + k]
        if abs(ratio * y[at.W_D] - y[at.W_G + k]) >= law.synchroniser.lock_slip_rad_s:
            continue
        before_j = stored_energy_j(y, law)
        shaft = law.shafts[k]
        other = law.shafts[1 - k]
        inertia_kg_m2 = law.output.inertia_kg_m2
        if modes[at.LINK + 1 - k] == ENGAGED:
            inertia_kg_m2 += u[at.RATIO + 1 - k] ** 2 * other.gear_inertia_kg_m2
        momentum = inertia_kg_m2 * y[at.W_D] + ratio * shaft.gear_inertia_kg_m2 * y[at.W_G + k]
        y[at.W_D] = momentum / (inertia_kg_m2 + ratio * ratio * shaft.gear_inertia_kg_m2)
        y[at.W_G + k] = ratio * y[at.W_D]
        if modes[at.LINK + 1 - k] == ENGAGED:
            y[at.W_G + 1 - k] = u[at.RATIO + 1 - k] * y[at.W_D]
        modes[at.LINK + k] = ENGAGED
        if account.size != 0:
            account[SYNCHRONISERS] += before_j - stored_energy_j(y, law)


@part
def advance_to_event(machine: Machine, longest_s: float, law: PlantLaw) -> float:
    """Take one step of at most ``longest_s`` that ends early where something may lock; return its length [s]."""
    y, u, work = machine.y, machine.u, machine.work
    resolve_clutch_modes(y, u, machine.modes, work.slope1, law)
    copy(y, work.before)
    save_account(work.account)
    air_flow = u[at.AIR_FLOW]
    step_s = longest_s
    step(machine, step_s, law)
    for _ in range(_EVENT_TRIES):
        fraction = event_fraction(machine, step_s, law)
        if fraction >= 1.0:
            break
        step_s = max(fraction * step_s, min(longest_s, _MIN_STEP_S))
        copy(work.before, y)
        restore_account(work.account)
        u[at.AIR_FLOW] = air_flow
        step(machine, step_s, law)
    close_synchronisers(machine, law)
    return step_s


@part
def advance_millisecond(machine: Machine, step_count: int, law: PlantLaw) -> None:
    """Advance plant and clock by one millisecond in ``step_count`` steps, more where something locks."""
    step_s = _MILLISECOND_S / step_count
    for _ in range(step_count):
        left_s = step_s
        while left_s > _MIN_STEP_S:
            left_s -= advance_to_event(machine, left_s, law)
    machine.clock[0] += 1
