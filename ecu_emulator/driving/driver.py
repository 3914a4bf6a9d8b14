"""The driver: looks ahead along the trace and moves the feet, no faster than feet move."""

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.indices import DriveState
from ecu_emulator.driving.laws import DrivingLaw, overrun_nm, pedal_for_force, pulls_on_wheels
from ecu_emulator.plant.driveline import road_load_n
from ecu_emulator.shift_control import tcu_data

GRID_S = 0.1  # of the trace as the driver sees it
_ROLLING_M_S = 0.15  # a trace below this stands still
_STANDING_M_S = 0.3
_RATE_LAG_S = 0.05
_STOPPING_M_S2 = 0.8  # the last metre before a stop
_TURNING_RATIO = 1.05  # mass of the car with all that turns, over its mass


@array_kernel
def seen(column: FloatArray, time_s: float) -> float:
    """Return what a column of the trace says at a time; its last value beyond its end."""
    place = time_s / GRID_S
    index = int(place)
    if index >= column.size - 1:
        return float(column[column.size - 1])
    return float(column[index] + (place - index) * (column[index + 1] - column[index]))


@array_kernel
def wanted_force_n(memory: FloatArray, sense: FloatArray, speeds: FloatArray, time_s: float, law: DrivingLaw) -> float:
    """Return the force that would bring the car onto the trace [N]: what lies ahead, corrected by the error."""
    p, vehicle = law.driving.driver, law.drive.plant.vehicle
    ahead_m_s2 = (seen(speeds, time_s + p.far_s) - seen(speeds, time_s + p.near_s)) / (p.far_s - p.near_s)
    speed_m_s = sense[at.VEHICLE_SPEED]
    error_m_s = seen(speeds, time_s + p.aim_s) - speed_m_s - p.aim_s * ahead_m_s2 * 0.5
    summed_m = memory[at.SPEED_INTEGRAL] + error_m_s * tcu_data.PERIOD_S
    memory[at.SPEED_INTEGRAL] = min(max(summed_m, -p.integral_limit_m), p.integral_limit_m)
    wanted_m_s2 = ahead_m_s2 + p.speed_gain_per_s * error_m_s + p.integral_gain_per_s2 * memory[at.SPEED_INTEGRAL]
    return float(_TURNING_RATIO * vehicle.mass_kg * wanted_m_s2 + road_load_n(speed_m_s, sense[at.GRADE], vehicle))


@array_kernel
def move_feet(memory: FloatArray, pedal: float, brake_m_s2: float, law: DrivingLaw) -> None:
    """Move pedal and brake towards what is wanted; the same foot serves both."""
    p, period_s = law.driving.driver, tcu_data.PERIOD_S
    if brake_m_s2 > 0.0 and memory[at.PEDAL] > 0.0:
        brake_m_s2 = 0.0
    if pedal > 0.0 and memory[at.BRAKE] > 0.0:
        pedal = 0.0
    step = min(max(pedal - memory[at.PEDAL], -p.pedal_release_per_s * period_s), p.pedal_press_per_s * period_s)
    memory[at.PEDAL] += step
    memory[at.PEDAL_RATE] += period_s / _RATE_LAG_S * (step / period_s - memory[at.PEDAL_RATE])
    step = brake_m_s2 - memory[at.BRAKE]
    memory[at.BRAKE] += min(max(step, -p.brake_release_m_s3 * period_s), p.brake_press_m_s3 * period_s)


@array_kernel
def is_waiting(sense: FloatArray, speeds: FloatArray, time_s: float, law: DrivingLaw) -> bool:
    """Tell whether car and trace stand still, and the trace goes on doing so for a moment."""
    ahead_m_s = max(seen(speeds, time_s), seen(speeds, time_s + law.driving.driver.departure_s))
    return bool(ahead_m_s < _ROLLING_M_S and abs(sense[at.VEHICLE_SPEED]) < _STANDING_M_S)


@array_kernel
def drive(memory: FloatArray, sense: FloatArray, speeds: FloatArray, time_s: float, law: DrivingLaw) -> None:
    """Take one step of 1 ms: pedal and brake."""
    p, vehicle = law.driving.driver, law.drive.plant.vehicle
    if is_waiting(sense, speeds, time_s, law):
        memory[at.SPEED_INTEGRAL] = 0.0
        move_feet(memory, 0.0, p.standing_brake_m_s2, law)
        return
    force_n = wanted_force_n(memory, sense, speeds, time_s, law)
    ratio = law.drive.overall_ratios[int(memory[tcu_data.CURRENT_GEAR])]
    overrun_n = overrun_nm(sense[tcu_data.ENGINE_SPEED], law) * ratio / vehicle.wheel_radius_m
    if not pulls_on_wheels(memory):
        overrun_n = 0.0
    margin_n = p.foot_change_n if memory[at.BRAKE] == 0.0 else 0.0
    is_stopping = seen(speeds, time_s + p.aim_s) < _ROLLING_M_S and seen(speeds, time_s + p.departure_s) < _ROLLING_M_S
    if force_n < overrun_n - margin_n or is_stopping:
        brake_m_s2 = (overrun_n - force_n) / vehicle.mass_kg
        move_feet(memory, 0.0, max(brake_m_s2, _STOPPING_M_S2 if is_stopping else 0.0), law)
        return
    pedal = pedal_for_force(force_n, sense[at.VEHICLE_SPEED], overrun_n, law.driving.pedal)
    if memory[at.WHIM_TIME] > 0.0:
        pedal = min(max(pedal + memory[at.WHIM_PEDAL], 0.0), 1.0)
    if memory[at.STATE] == DriveState.STANDSTILL.value and memory[at.BRAKE] > 0.0:
        pedal = 0.0
    move_feet(memory, pedal, 0.0, law)
