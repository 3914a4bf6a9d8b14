"""What is constant over a drive, from a file; what the pedal asks for; the questions that several controllers ask."""

import tomllib
from importlib.resources import files
from typing import NamedTuple

from canlog.arrays import FloatArray
from canlog.jit import part
from clutch_model.tables import record_from
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.indices import DrivelineState, ManoeuvreKind
from ecu_emulator.plant.driveline import CYCLE_RAD
from ecu_emulator.plant.loop import DriveLaw
from ecu_emulator.shift_control import tcu_data


class DriverParameters(NamedTuple):
    """How the driver looks ahead and moves the feet."""

    near_s: float
    far_s: float
    aim_s: float
    departure_s: float
    speed_gain_per_s: float
    integral_gain_per_s2: float
    integral_limit_m: float
    pedal_press_per_s: float
    pedal_release_per_s: float
    brake_press_m_s3: float
    brake_release_m_s3: float
    standing_brake_m_s2: float
    foot_change_n: float


class PedalParameters(NamedTuple):
    """What the pedal means: a force at the wheels."""

    overrun_ratio: float
    force_n: float
    power_w: float


class EngineControlParameters(NamedTuple):
    """Idle control, torque limits, fuel cut, stop-start."""

    warm_idle_rad_s: float
    cold_idle_rad_s: float
    warm_k: float
    cold_k: float
    idle_gain_nms_rad: float
    idle_integral_gain_nm_rad: float
    idle_reserve_ratio: float
    least_spark_ratio: float
    demand_lag_s: float
    full_torque_nm: float
    top_rad_s: float
    cut_above_idle_rad_s: float
    resume_above_idle_rad_s: float
    cut_delay_s: float
    starter_nm: float
    starter_end_rad_s: float
    firing_rad_s: float
    stop_delay_s: float
    stop_coolant_k: float


class ChoiceParameters(NamedTuple):
    """The shift map over pedal and speed, with its hysteresis."""

    low_rad_s: float
    rise_rad_s: float
    foresight_s: float
    first_pedal_ratio: float
    braking_ahead_s: float
    up_ratio: float
    up_margin_rad_s: float
    down_ratio: float
    down_margin_rad_s: float
    top_rad_s: float
    down_top_rad_s: float
    over_rad_s: float
    up_dwell_s: float
    down_dwell_s: float
    settle_s: float
    open_above_idle_rad_s: float
    kickdown_pedal_ratio: float


class LaunchParameters(NamedTuple):
    creep_nm: float
    creep_fade_rad_s: float
    creep_ramp_nm_s: float
    engine_above_idle_rad_s: float
    engine_per_pedal_rad_s: float
    engine_rate_rad_s2: float
    clutch_gain_nms_rad: float
    clutch_lag_s: float
    engine_gain_nms_rad: float
    engine_help_nm: float
    abort_s: float
    top_nm: float
    lock_gain_nms_rad: float
    lock_lag_s: float
    lock_fade_s: float
    lock_rate_rad_s2: float
    locked_s: float
    stubborn_s: float
    stubborn_nm_s: float
    hold_rate_nm_s: float
    long_s: float
    late_rad_s2: float
    late_above_idle_rad_s: float


class ChangeParameters(NamedTuple):
    """Changes of gear that the shift cycles do not know."""

    raise_time_s: float
    raise_rad_s2: float
    handover_s: float
    overshoot_rad_s: float
    gain_nms_rad: float
    blip_gain_nms_rad: float
    blip_rad_s2: float
    catch_rad_s: float
    catch_nm: float
    catch_rate_nm_s: float
    catch_limit_nm: float
    return_s: float
    longest_s: float


class LockUpParameters(NamedTuple):
    """The lock-up clutch of a converter and the changes of gear before it."""

    least_gear: float
    least_oil_k: float
    on_rad_s: float
    off_rad_s: float
    locked_rad_s: float
    hysteresis_rad_s: float
    most_pedal_ratio: float
    settle_s: float
    apply_s: float
    least_slip_rad_s: float
    most_slip_rad_s: float
    most_slip_nm: float
    gain_nms_rad: float
    integral_gain_nm_rad: float
    slip_lag_s: float
    coast_nm: float
    hold_ratio: float
    hold_nm: float
    release_s: float
    change_s: float
    spark_reduction_ratio: float


class SurroundingsParameters(NamedTuple):
    """Warming of the coolant, drag of open packs, brakes at rest, synchronisers in the cold."""

    coolant_time_s: float
    thermostat_k: float
    open_drag_nm: float
    open_drag_viscosity_pa_s: float
    open_drag_exponent: float
    full_brake_m_s: float
    hold_m_s: float
    synchroniser_lock_rad_s: float


class DrivingParameters(NamedTuple):
    driver: DriverParameters
    pedal: PedalParameters
    engine: EngineControlParameters
    choice: ChoiceParameters
    launch: LaunchParameters
    change: ChangeParameters
    lock_up: LockUpParameters
    surroundings: SurroundingsParameters


def nominal_driving() -> DrivingParameters:
    """Return the numbers that ship with the package."""
    text = files("ecu_emulator").joinpath("driving/parameters.toml").read_text(encoding="utf-8")
    return record_from(DrivingParameters, tomllib.loads(text))


_CLOSED_MANIFOLD_RATIO = 0.25  # of ambient pressure, throttle closed, engine turned by the car


class DrivingLaw(NamedTuple):
    """A car, and how it is driven."""

    drive: DriveLaw
    driving: DrivingParameters


@part
def idle_rad_s(sense: FloatArray, law: DrivingLaw) -> float:
    """Return the speed the engine shall idle at [rad/s]: the colder the coolant, the faster."""
    p = law.driving.engine
    share = (sense[at.COOLANT] - p.cold_k) / (p.warm_k - p.cold_k)
    return float(p.cold_idle_rad_s + min(max(share, 0.0), 1.0) * (p.warm_idle_rad_s - p.cold_idle_rad_s))


@part
def overrun_nm(engine_rad_s: float, law: DrivingLaw) -> float:
    """Return the torque of the engine that the car turns, fuel cut [N m]: negative."""
    engine = law.drive.plant.engine
    pumping_nm = (1.0 - _CLOSED_MANIFOLD_RATIO) * engine.ambient_pressure_pa * engine.displacement_m3 / CYCLE_RAD
    return float(-(engine.friction_nm + engine.friction_nms_rad * engine_rad_s + pumping_nm))


@part
def gear_speed_rad_s(sense: FloatArray, gear: int, law: DrivingLaw) -> float:
    """Return the speed of an input shaft that had this gear [rad/s]."""
    return float(sense[at.DIFF_SPEED] * law.drive.overall_ratios[gear])


@part
def enter_state(memory: FloatArray, state: int) -> None:
    memory[at.STATE] = state
    memory[at.STATE_TIME] = 0.0
    memory[tcu_data.PHASE] = tcu_data.HOLD
    memory[tcu_data.PHASE_TIME] = 0.0


@part
def begin_event(memory: FloatArray, kind: int) -> None:
    """Begin an event; one that was going on is over."""
    memory[at.EVENT_KIND] = kind
    memory[at.EVENT_COUNT] += 1.0
    memory[at.EVENT_NUMBER] = memory[at.EVENT_COUNT]
    memory[at.IS_ABORTED] = 0.0


@part
def end_event(memory: FloatArray) -> None:
    memory[at.EVENT_KIND] = ManoeuvreKind.NONE.value
    memory[at.EVENT_NUMBER] = 0.0
    memory[at.IS_ABORTED] = 0.0


@part
def pulls_on_wheels(memory: FloatArray) -> bool:
    """Tell whether engine and wheels are connected well enough for the engine to brake the car."""
    return bool(memory[at.STATE] == DrivelineState.IN_GEAR.value or memory[at.STATE] == DrivelineState.CHANGING.value)


@part
def shift_shaft(
    memory: FloatArray, sense: FloatArray, commands: FloatArray, shaft: int, gear: int, law: DrivingLaw
) -> bool:
    """Move an unloaded shaft to a gear, over neutral; True once the gear is engaged."""
    has_gear = int(sense[tcu_data.SHAFT_GEAR + shaft])
    is_engaged = sense[tcu_data.IS_ENGAGED + shaft] != 0.0
    if has_gear == gear:
        return bool(is_engaged)
    control = law.drive.control
    if has_gear != 0:
        if is_engaged and sense[tcu_data.FILL + shaft] < control.preselect_fill_ratio:
            commands[tcu_data.WANTED_GEAR + shaft] = 0.0
            memory[at.NEUTRAL_SINCE + shaft] = 0.0
        return False
    memory[at.NEUTRAL_SINCE + shaft] += tcu_data.PERIOD_S
    if memory[at.NEUTRAL_SINCE + shaft] >= control.neutral_time_s:
        commands[tcu_data.WANTED_GEAR + shaft] = gear
    return False


@part
def full_force_n(vehicle_m_s: float, p: PedalParameters) -> float:
    """Return the force at the wheels that the full pedal asks for [N]."""
    return min(p.force_n, p.power_w / max(vehicle_m_s, 1.0))


@part
def asked_force_n(pedal: float, vehicle_m_s: float, overrun_n: float, p: PedalParameters) -> float:
    """Return the force at the wheels [N] that a pedal asks for; released, the engine brakes with ``overrun_n`` < 0."""
    if pedal >= p.overrun_ratio:
        return (pedal - p.overrun_ratio) / (1.0 - p.overrun_ratio) * full_force_n(vehicle_m_s, p)
    return (1.0 - pedal / p.overrun_ratio) * overrun_n


@part
def pedal_for_force(force_n: float, vehicle_m_s: float, overrun_n: float, p: PedalParameters) -> float:
    """Return the pedal that asks for a force at the wheels: `asked_force_n` solved for it, within 0..1."""
    if force_n >= 0.0:
        share = force_n / full_force_n(vehicle_m_s, p)
        return min(p.overrun_ratio + share * (1.0 - p.overrun_ratio), 1.0)
    if overrun_n >= 0.0:
        return 0.0
    return max(p.overrun_ratio * (1.0 - force_n / overrun_n), 0.0)
