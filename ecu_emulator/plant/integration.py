"""Integration of the plant over a millisecond: second-order steps that stop exactly where a clutch may lock."""

import math

import numpy as np
import numpy.typing as npt

from clutch_model.jit import kernel
from ecu_emulator.plant import state as at
from ecu_emulator.plant.audit import SYNCHRONISERS, add_powers, stored_energy_j
from ecu_emulator.plant.clutch import advance_clutch
from ecu_emulator.plant.driveline import ENGAGED, SYNCHRONISING
from ecu_emulator.plant.engine import throttle_flow_kg_s
from ecu_emulator.plant.rates import PlantLaw, evaluate, settle_modes

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_MILLISECOND_S = 1.0e-3
_MIN_STEP_S = 1.0e-9
_SETTLED = 1.0e-12  # a lag this close to its command has arrived
_INSIDE_BAND = 0.98  # an event step aims a little inside the lock band, so that rounding cannot miss it

# Rows of the work array.
SLOPE1 = 0
SLOPE2 = 1
PREDICTED = 2
BEFORE = 3
WORK_COUNT = 4


@kernel
def settle(y: FloatArray, u: FloatArray, modes: IntArray, out: FloatArray, law: PlantLaw) -> None:
    """Evaluate the plant at ``y`` and bring the clutch modes into agreement with the torques."""
    evaluate(y, u, modes, out, law)
    if settle_modes(y, u, modes, out, law):
        evaluate(y, u, modes, out, law)


@kernel
def advance_lags(y: FloatArray, u: FloatArray, dt_s: float, law: PlantLaw) -> None:
    """Advance throttle and spark exactly, and the air flow with the throttle."""
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


@kernel
def heun_step(  # noqa: PLR0917 - a kernel takes its arguments by position
    y: FloatArray, u: FloatArray, modes: IntArray, work: FloatArray, dt_s: float, law: PlantLaw
) -> None:
    """Advance everything by ``dt_s`` with the modes frozen; ``work[SLOPE1]`` holds the rates at the start."""
    slope1, slope2, predicted = work[SLOPE1], work[SLOPE2], work[PREDICTED]
    advance_lags(y, u, dt_s, law)
    advance_clutch(y, u, 0, dt_s, law.clutches[0])
    advance_clutch(y, u, 1, dt_s, law.clutches[1])
    for i in range(at.RATE_COUNT):
        predicted[i] = y[i] + dt_s * slope1[i]
    for i in range(at.RATE_COUNT, at.STATE_COUNT):
        predicted[i] = y[i]
    evaluate(predicted, u, modes, slope2, law)
    for i in range(at.RATE_COUNT):
        y[i] += 0.5 * dt_s * (slope1[i] + slope2[i])


@kernel
def lock_fraction(y: FloatArray, before: FloatArray, modes: IntArray, law: PlantLaw) -> float:
    """Return the share of the last step after which the first slipping clutch entered its lock band, else 1."""
    fraction = 1.0
    for k in range(2):
        clutch = law.clutches[0] if k == 0 else law.clutches[1]
        band = clutch.friction.lock_band_rad_s
        old = before[at.W_H] - before[at.W_L + k]
        if modes[at.STICK + k] != 0 or abs(old) <= band:
            continue
        sign = 1.0 if old > 0.0 else -1.0
        new = sign * (y[at.W_H] - y[at.W_L + k])
        if new <= band:
            target = _INSIDE_BAND * band
            fraction = min(fraction, (abs(old) - target) / max(abs(old) - new, abs(old) - target))
    return fraction


@kernel
def close_synchronisers(
    y: FloatArray, u: FloatArray, modes: IntArray, account: FloatArray, law: PlantLaw
) -> None:
    """Engage a gear whose synchroniser has done its work, conserving momentum."""
    for k in range(2):
        if modes[at.LINK + k] != SYNCHRONISING:
            continue
        ratio = u[at.RATIO + k]
        if abs(ratio * y[at.W_D] - y[at.W_G + k]) >= law.synchroniser.lock_slip_rad_s:
            continue
        before_j = stored_energy_j(y, law)
        shaft, other = (law.shafts[0], law.shafts[1]) if k == 0 else (law.shafts[1], law.shafts[0])
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


@kernel
def advance_to_event(  # noqa: PLR0917 - a kernel takes its arguments by position
    y: FloatArray,
    u: FloatArray,
    modes: IntArray,
    work: FloatArray,
    account: FloatArray,
    longest_s: float,
    law: PlantLaw,
) -> float:
    """Take one step of at most ``longest_s`` that ends early where a clutch may lock; return its length [s]."""
    settle(y, u, modes, work[SLOPE1], law)
    before = work[BEFORE]
    before[:] = y
    air_flow = u[at.AIR_FLOW]
    taken_s = longest_s
    heun_step(y, u, modes, work, taken_s, law)
    fraction = lock_fraction(y, before, modes, law)
    if fraction < 1.0:
        taken_s = max(fraction * longest_s, min(longest_s, _MIN_STEP_S))
        y[:] = before
        u[at.AIR_FLOW] = air_flow
        heun_step(y, u, modes, work, taken_s, law)
    if account.size != 0:
        add_powers(account, 0.5 * taken_s, before, u, modes, work[SLOPE1], law)
        add_powers(account, 0.5 * taken_s, work[PREDICTED], u, modes, work[SLOPE2], law)
    close_synchronisers(y, u, modes, account, law)
    return taken_s


@kernel
def advance_millisecond(  # noqa: PLR0917 - a kernel takes its arguments by position
    y: FloatArray,
    u: FloatArray,
    modes: IntArray,
    work: FloatArray,
    account: FloatArray,
    step_count: int,
    law: PlantLaw,
) -> None:
    """Advance the plant by one millisecond in ``step_count`` steps, more where a clutch locks."""
    step_s = _MILLISECOND_S / step_count
    for _ in range(step_count):
        left_s = step_s
        while left_s > _MIN_STEP_S:
            left_s -= advance_to_event(y, u, modes, work, account, left_s, law)
