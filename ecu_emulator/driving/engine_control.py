"""The engine controller: the driver's wish, idle, what the transmission asks for, fuel cut, stop-start."""

import math

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.indices import DrivelineState, EngineMode
from ecu_emulator.driving.laws import DrivingLaw, asked_force_n, idle_rad_s, overrun_nm, pulls_on_wheels
from ecu_emulator.plant.driveline import (
    CYCLE_RAD,
    FLOW_SHARPNESS,
    cylinder_air_kg_rad,
    engine_losses_nm,
    mean_indicated_torque_nm,
)
from ecu_emulator.shift_control import tcu_data

_INTEGRAL_LOW_NM = -10.0
_INTEGRAL_HIGH_NM = 80.0
_NEAR_IDLE_RAD_S = 30.0
_FOOT_OFF_RATIO = 0.8  # of the overrun torque: the driver asks for nothing
_FOOT_ON_RATIO = 0.5
_BRAKE_FELT_M_S2 = 0.5
_IDLE_BAND_RAD_S = 40.0
_RUNNING_RATIO = 0.92  # of the speed at which the starter gives nothing: a loaded engine does not reach all of it
_TOP_BAND_RAD_S = 40.0  # over which the torque fades towards the top speed


@part
def wished_torque_nm(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> float:
    """Return the crankshaft torque that gives the force at the wheels the pedal asks for [N m]."""
    p = law.driving
    is_late = memory[tcu_data.PHASE] == tcu_data.LOCK_UP
    is_up = memory[tcu_data.TARGET_GEAR] > memory[tcu_data.CURRENT_GEAR]
    is_late = is_late or (is_up and memory[tcu_data.PHASE] == tcu_data.INERTIA)
    gear = int(memory[tcu_data.TARGET_GEAR] if is_late else memory[tcu_data.CURRENT_GEAR])
    ratio = law.drive.overall_ratios[gear]
    radius_m = law.drive.plant.vehicle.wheel_radius_m
    least_nm = overrun_nm(sense[tcu_data.ENGINE_SPEED], law)
    overrun_n = least_nm * ratio / radius_m if pulls_on_wheels(memory) else 0.0
    force_n = asked_force_n(memory[at.PEDAL], sense[at.VEHICLE_SPEED], overrun_n, p.pedal)
    efficiency = law.drive.plant.synchroniser.efficiency_ratio if force_n > 0.0 else 1.0
    return float(min(max(force_n * radius_m / (ratio * efficiency), least_nm), p.engine.full_torque_nm))


@part
def set_air(commands: FloatArray, sense: FloatArray, torque_nm: float, spark: float, law: DrivingLaw) -> None:
    """Slow path: the throttle at which the engine settles at a torque, its spark at this factor."""
    engine, air_k = law.drive.plant.engine, law.drive.plant.air_k
    speed_rad_s = max(sense[tcu_data.ENGINE_SPEED], 20.0)
    pumping_nm_pa = engine.displacement_m3 / CYCLE_RAD
    air_per_pa = cylinder_air_kg_rad(1.0, air_k, engine)
    friction_nm = engine.friction_nm + engine.friction_nms_rad * speed_rad_s
    needed_nm = torque_nm + friction_nm + pumping_nm_pa * engine.ambient_pressure_pa
    manifold_pa = needed_nm / (engine.torque_per_air_j_kg * air_per_pa * spark + pumping_nm_pa)
    manifold_pa = min(max(manifold_pa, 0.0), engine.ambient_pressure_pa)
    # The throttle that holds this charge of air in the steady state.
    flow_ratio = 1.0 - math.exp(FLOW_SHARPNESS * (min(manifold_pa / engine.ambient_pressure_pa, 0.999) - 1.0))
    opening = air_per_pa * manifold_pa * speed_rad_s / (engine.max_air_flow_kg_s * flow_ratio)
    angle_rad = math.acos(min(max(1.0 - opening, 0.0), 1.0)) - engine.closed_throttle_rad
    commands[tcu_data.THROTTLE] = min(max(angle_rad / (0.5 * math.pi - engine.closed_throttle_rad), 0.0), 1.0)


@part
def set_spark(commands: FloatArray, sense: FloatArray, torque_nm: float, law: DrivingLaw) -> None:
    """Fast path: the spark that takes away at once what the air gives too much; a shift's own factor on top."""
    engine, air_k = law.drive.plant.engine, law.drive.plant.air_k
    losses_nm = engine_losses_nm(sense[at.MANIFOLD], sense[tcu_data.ENGINE_SPEED], engine)
    at_hand_nm = max(mean_indicated_torque_nm(sense[at.MANIFOLD], 1.0, air_k, engine), 1.0)
    share = (torque_nm + losses_nm) / at_hand_nm
    commands[tcu_data.SPARK] *= min(max(share, law.driving.engine.least_spark_ratio), 1.0)


@part
def idle_torque_nm(memory: FloatArray, sense: FloatArray, wish_nm: float, law: DrivingLaw) -> float:
    """Return the torque that keeps the engine at its idle speed [N m]; its integral part is bounded."""
    p = law.driving.engine
    error_rad_s = idle_rad_s(sense, law) - sense[tcu_data.ENGINE_SPEED]
    torque_nm = memory[at.IDLE_INTEGRAL] + p.idle_gain_nms_rad * error_rad_s
    if torque_nm >= wish_nm and abs(error_rad_s) < _NEAR_IDLE_RAD_S:
        moved_nm = memory[at.IDLE_INTEGRAL] + p.idle_integral_gain_nm_rad * error_rad_s * tcu_data.PERIOD_S
        memory[at.IDLE_INTEGRAL] = min(max(moved_nm, _INTEGRAL_LOW_NM), _INTEGRAL_HIGH_NM)
    return float(torque_nm)


@part
def enter_engine_state(memory: FloatArray, state: int) -> None:
    memory[at.ENGINE_STATE] = state
    memory[at.ENGINE_TIME] = 0.0


@part
def stop_and_start(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> None:
    """Stop the engine at a standstill, crank it when a foot moves."""
    p, state = law.driving.engine, int(memory[at.ENGINE_STATE])
    is_resting = memory[at.STATE] == DrivelineState.STANDSTILL.value and memory[at.PEDAL] == 0.0
    is_resting = is_resting and memory[at.BRAKE] > _BRAKE_FELT_M_S2
    if state == EngineMode.STOPPED.value:
        if not is_resting:
            enter_engine_state(memory, EngineMode.CRANKING.value)
    elif state == EngineMode.CRANKING.value:
        if sense[tcu_data.ENGINE_SPEED] > _RUNNING_RATIO * p.starter_end_rad_s:
            memory[at.IDLE_INTEGRAL] = 0.0
            enter_engine_state(memory, EngineMode.FIRING.value)
    elif is_resting and memory[at.STATE_TIME] > p.stop_delay_s and sense[at.COOLANT] > p.stop_coolant_k:
        enter_engine_state(memory, EngineMode.STOPPED.value)


@part
def cut_fuel(memory: FloatArray, sense: FloatArray, commands: FloatArray, wish_nm: float, law: DrivingLaw) -> None:
    """Cut the fuel while the car turns the engine and nobody asks for torque."""
    p = law.driving.engine
    above_rad_s = sense[tcu_data.ENGINE_SPEED] - idle_rad_s(sense, law)
    least_nm = overrun_nm(sense[tcu_data.ENGINE_SPEED], law)
    is_asked = commands[at.REQUEST] != at.NO_REQUEST and commands[at.REQUESTED_TORQUE] > _FOOT_ON_RATIO * least_nm
    if memory[at.ENGINE_STATE] == EngineMode.FUEL_CUT.value:
        if above_rad_s < p.resume_above_idle_rad_s or wish_nm > _FOOT_ON_RATIO * least_nm or is_asked:
            enter_engine_state(memory, EngineMode.FIRING.value)
        return
    is_off = wish_nm < _FOOT_OFF_RATIO * least_nm and above_rad_s > p.cut_above_idle_rad_s and not is_asked
    memory[at.OVERRUN_TIME] = memory[at.OVERRUN_TIME] + tcu_data.PERIOD_S if is_off else 0.0
    if memory[at.OVERRUN_TIME] > p.cut_delay_s:
        enter_engine_state(memory, EngineMode.FUEL_CUT.value)


@part
def crank(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Leave the engine at rest, or turn it with the starter and fire when it is fast enough."""
    p, speed_rad_s = law.driving.engine, sense[tcu_data.ENGINE_SPEED]
    set_air(commands, sense, 0.0, 1.0, law)
    commands[tcu_data.SPARK] = 0.0
    if memory[at.ENGINE_STATE] == EngineMode.CRANKING.value:
        commands[at.STARTER] = p.starter_nm * max(1.0 - speed_rad_s / p.starter_end_rad_s, 0.0)
        commands[tcu_data.SPARK] = 0.6 if speed_rad_s > p.firing_rad_s else 0.0


@part
def control_engine(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Take one step of 1 ms: throttle, spark and starter for what driver, idle and transmission want."""
    p = law.driving.engine
    memory[at.ENGINE_TIME] += tcu_data.PERIOD_S
    commands[at.STARTER] = 0.0
    blend = 1.0 - math.exp(-tcu_data.PERIOD_S / p.demand_lag_s)
    memory[at.DEMAND] += blend * (wished_torque_nm(memory, sense, law) - memory[at.DEMAND])
    stop_and_start(memory, sense, law)
    if memory[at.ENGINE_STATE] >= EngineMode.STOPPED.value:
        crank(memory, sense, commands, law)
        return
    torque_nm = memory[at.DEMAND]
    if commands[at.REQUEST] == at.AT_LEAST:
        torque_nm = max(torque_nm, commands[at.REQUESTED_TORQUE])
    elif commands[at.REQUEST] == at.EXACTLY:
        torque_nm = commands[at.REQUESTED_TORQUE]
    cut_fuel(memory, sense, commands, torque_nm, law)
    torque_nm = max(torque_nm, idle_torque_nm(memory, sense, torque_nm, law))
    fading = min(max((p.top_rad_s - sense[tcu_data.ENGINE_SPEED]) / _TOP_BAND_RAD_S, 0.0), 1.0)
    torque_nm = min(torque_nm, fading * p.full_torque_nm)
    is_idling = (
        sense[tcu_data.ENGINE_SPEED] < idle_rad_s(sense, law) + _IDLE_BAND_RAD_S and torque_nm < _IDLE_BAND_RAD_S
    )
    set_air(commands, sense, torque_nm, p.idle_reserve_ratio if is_idling else 1.0, law)
    set_spark(commands, sense, torque_nm, law)
    if memory[at.ENGINE_STATE] == EngineMode.FUEL_CUT.value:
        commands[tcu_data.SPARK] = 0.0
