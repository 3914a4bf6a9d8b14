"""Numbers of a drive beyond the plant's: driver, pedal, engine and clutch control, choice of gears, surroundings."""

import math
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import NamedTuple

from clutch_model.tables import record_from, require


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
    return driving_parameters(tomllib.loads(text))


def driving_parameters(table: Mapping[str, object]) -> DrivingParameters:
    """Return the numbers of nested tables.

    Raises CalibrationError if a number is missing, unknown or not above zero.
    """
    driving = record_from(DrivingParameters, table)
    for name, record in driving._asdict().items():
        for key, value in record._asdict().items():
            require(math.isfinite(value) and value > 0.0, f"{name}.{key} must be > 0, got {value}")
    return driving
