"""The shift map over pedal and speed, and which gear the idle shaft looks for."""

import math

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.laws import DrivingLaw, gear_speed_rad_s, idle_rad_s, shift_shaft
from ecu_emulator.shift_control import tcu, tcu_data

_BRAKING_M_S2 = 0.3
_FORESEEN_RATIO = 1.5  # of the time of an upshift: a foot that is off by then shall not meet its end
_LOWEST_SKIPPED_FROM = 4  # 4-2 and above
_LOWEST_COASTING = 2  # the car rolls out of 2nd gear with open clutches
_LOST_RATIO = 0.5  # of the idle speed: a higher gear than 2nd that turns its shaft slower has been left behind


@part
def low_rad_s(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> float:
    """Return the engine speed below which a gear is too high [rad/s]: the pedal raises it, so does a cold engine."""
    p = law.driving.choice
    cold_rad_s = idle_rad_s(sense, law) - law.driving.engine.warm_idle_rad_s
    soon = min(memory[at.PEDAL] + p.foresight_s * max(memory[at.PEDAL_RATE], 0.0), 1.0)
    return float(p.low_rad_s + p.rise_rad_s * soon * math.sqrt(soon) + cold_rad_s)


@part
def is_highest(gear: int, law: DrivingLaw) -> bool:
    return bool(law.drive.overall_ratios[gear + 1] == 0.0)


@part
def wants_up(memory: FloatArray, sense: FloatArray, gear: int, law: DrivingLaw) -> bool:
    """Tell whether the gear above this one would turn the engine fast enough, or this one turns it too fast."""
    p = law.driving.choice
    if is_highest(gear, law) or memory[at.BRAKE] > _BRAKING_M_S2:
        return False
    if gear_speed_rad_s(sense, gear, law) > p.top_rad_s:
        return True
    return bool(gear_speed_rad_s(sense, gear + 1, law) > p.up_ratio * low_rad_s(memory, sense, law) + p.up_margin_rad_s)


@part
def is_foot_coming_off(memory: FloatArray, law: DrivingLaw) -> bool:
    """Tell whether the pedal will be released before an upshift that begins now has settled."""
    control, overrun_ratio = law.drive.control, law.driving.pedal.overrun_ratio
    upshift_s = control.prefill_time_s + control.torque_phase_s + control.upshift_inertia_phase_s
    soon = memory[at.PEDAL] + _FORESEEN_RATIO * upshift_s * memory[at.PEDAL_RATE]
    return bool(memory[at.PEDAL] > overrun_ratio >= soon)


@part
def is_gear_lost(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> bool:
    """Tell whether no change from gear to gear is quick enough: somebody has moved or stopped the car at once."""
    gear = int(memory[tcu_data.CURRENT_GEAR])
    speed_rad_s = gear_speed_rad_s(sense, gear, law)
    if speed_rad_s > law.driving.choice.over_rad_s:
        return not is_highest(gear, law)
    return gear > _LOWEST_COASTING and speed_rad_s < _LOST_RATIO * idle_rad_s(sense, law)


@part
def highest_pulling_gear(
    memory: FloatArray, sense: FloatArray, rad_per_m: float, speed_m_s: float, law: DrivingLaw
) -> int:
    """Return the highest gear that turns the engine fast enough at a speed of the car."""
    gear, least_rad_s = tcu_data.MOST_GEARS, law.driving.choice.up_ratio * low_rad_s(memory, sense, law)
    while gear > 1 and speed_m_s * rad_per_m * law.drive.overall_ratios[gear] < least_rad_s:
        gear -= 1
    return gear


@part
def lower_gear(memory: FloatArray, sense: FloatArray, gear: int, is_pulling: bool, law: DrivingLaw) -> int:  # noqa: FBT001 - kernels take their arguments by position
    """Return the gear to change down to, or this one if it is low enough; two gears at once on one shaft at most."""
    p, low = law.driving.choice, low_rad_s(memory, sense, law)
    lowest = 1 if is_pulling and memory[at.PEDAL] > p.first_pedal_ratio else _LOWEST_COASTING
    speed_m_s = max(sense[at.VEHICLE_SPEED], 1.0)
    soon_ratio = max(1.0 - p.braking_ahead_s * memory[at.BRAKE] / speed_m_s, 0.0)
    if gear <= lowest or gear_speed_rad_s(sense, gear, law) >= p.down_ratio * low - p.down_margin_rad_s:
        return gear
    if gear_speed_rad_s(sense, gear - 1, law) > p.down_top_rad_s:
        return gear
    may_skip = gear >= _LOWEST_SKIPPED_FROM and gear_speed_rad_s(sense, gear - 2, law) < p.down_top_rad_s
    if may_skip and soon_ratio * gear_speed_rad_s(sense, gear - 1, law) < p.down_ratio * low:
        return gear - 2
    return gear - 1


@part
def requested_gear(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> int:
    """Return the next gear on the way to the one requested; a request that the engine speed forbids is dropped."""
    gear, wanted = int(memory[tcu_data.CURRENT_GEAR]), int(memory[at.REQUESTED_GEAR])
    following = gear + 1 if wanted > gear else gear - 1
    if wanted != gear and not (following > gear and is_highest(gear, law)):
        speed_rad_s = gear_speed_rad_s(sense, following, law)
        if idle_rad_s(sense, law) < speed_rad_s < law.driving.choice.down_top_rad_s:
            return following
    memory[at.REQUESTED_GEAR] = 0.0
    return gear


@part
def wanted_gear(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> int:
    """Return the gear that is requested, or the map asks for now, after the least time in the present one."""
    if memory[at.REQUESTED_GEAR] != 0.0:
        return requested_gear(memory, sense, law)
    p, gear = law.driving.choice, int(memory[tcu_data.CURRENT_GEAR])
    is_pulling = memory[at.PEDAL] > law.driving.pedal.overrun_ratio
    if memory[tcu_data.DWELL] > p.down_dwell_s:
        lower = lower_gear(memory, sense, gear, is_pulling, law)
        if lower != gear:
            return lower
    if memory[tcu_data.DWELL] > p.up_dwell_s and wants_up(memory, sense, gear, law):
        return gear + 1
    return gear


@part
def likely_gear(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> int:
    """Return the gear that will probably come next: the nearer of both thresholds."""
    p, gear = law.driving.choice, int(memory[tcu_data.CURRENT_GEAR])
    if gear == 1:
        return 2
    if is_highest(gear, law):
        return gear - 1
    low = low_rad_s(memory, sense, law)
    ratios = law.drive.overall_ratios
    top_rad_s = (p.up_ratio * low + p.up_margin_rad_s) * ratios[gear] / ratios[gear + 1]
    bottom_rad_s = p.down_ratio * low - p.down_margin_rad_s
    return gear + 1 if gear_speed_rad_s(sense, gear, law) > 0.5 * (top_rad_s + bottom_rad_s) else gear - 1


@part
def preselect(memory: FloatArray, sense: FloatArray, commands: FloatArray, wanted: int, law: DrivingLaw) -> bool:
    """Move the idle shaft to the gear that is wanted, or likely to be; True if the wanted change may begin."""
    gear = int(memory[tcu_data.CURRENT_GEAR])
    idle = 1 - tcu.clutch_of(gear)
    looked_for = likely_gear(memory, sense, law)
    memory[at.LOOKED_FOR_TIME] += tcu_data.PERIOD_S
    if looked_for == memory[at.LOOKED_FOR_GEAR]:
        memory[at.LOOKED_FOR_TIME] = 0.0
    if memory[at.LOOKED_FOR_GEAR] == 0.0 or tcu.clutch_of(int(memory[at.LOOKED_FOR_GEAR])) != idle:
        has_gear = sense[tcu_data.SHAFT_GEAR + idle]  # the shafts have just changed roles
        memory[at.LOOKED_FOR_GEAR] = has_gear if has_gear != 0.0 else looked_for
    if wanted != gear:
        memory[at.LOOKED_FOR_GEAR] = gear - 1 if wanted == gear - 2 else wanted
    elif memory[at.LOOKED_FOR_TIME] > law.driving.choice.settle_s:
        memory[at.LOOKED_FOR_GEAR] = looked_for
    is_ready = shift_shaft(memory, sense, commands, idle, int(memory[at.LOOKED_FOR_GEAR]), law)
    return is_ready and wanted != gear
