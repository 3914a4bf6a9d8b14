"""The quantities that the vehicle measures and the errors of the chains that measure them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Final
from zlib import crc32

import numpy as np

from clutch_model.units import m_s_from_km_h, pa_from_bar, rad_s_from_rpm
from ecu_emulator.errors import ConfigError

MAX_DELAY_S: Final = 0.5  # the longest latency or lag a measuring chain may have
UNITS: Final = ("rad_s", "m_s", "nm", "pa", "ratio", "k", "m")  # longest first: the unit ends a quantity's name

_SPEED_NOISE_RAD_S: Final = float(rad_s_from_rpm(2.0))
_PRESSURE_NOISE_PA: Final = float(pa_from_bar(0.05))
_WHEEL_NOISE_M_S: Final = float(m_s_from_km_h(0.05))
_TORQUE_NOISE_NM: Final = 3.0
_TEMPERATURE_NOISE_K: Final = 0.3
_MANIFOLD_NOISE_PA: Final = 500.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """One measuring chain: ``reading(t) = gain * lag(quantity)(t - latency) + offset + noise``.

    ``offset`` and ``noise_std`` are in the unit that ends the quantity's name. Resolution is the wire contract's:
    readings are rounded where frames are built.
    """

    gain_ratio: float = 1.0
    offset: float = 0.0
    noise_std: float = 0.0  # white and Gaussian
    latency_s: float = 0.0  # pure delay
    lag_s: float = 0.0  # time constant of a first-order low-pass, 0: none

    def __post_init__(self) -> None:
        """Check that the chain can exist: it neither amplifies wildly nor sees the future."""
        for field in fields(self):
            if not math.isfinite(getattr(self, field.name)):
                raise ConfigError(f"{field.name} must be finite")
        if not 0.1 <= self.gain_ratio <= 10.0:
            raise ConfigError(f"gain_ratio must be 0.1..10, got {self.gain_ratio}")
        if self.noise_std < 0.0:
            raise ConfigError(f"noise_std must be >= 0, got {self.noise_std}")
        for name in ("latency_s", "lag_s"):
            if not 0.0 <= getattr(self, name) <= MAX_DELAY_S:
                raise ConfigError(f"{name} must be 0..{MAX_DELAY_S}, got {getattr(self, name)}")


Sensors = Mapping[str, Sensor]

_NOISE_STD: Final = {
    "engine_speed_rad_s": _SPEED_NOISE_RAD_S,
    "engine_torque_nm": _TORQUE_NOISE_NM,
    "pedal_ratio": 0.0,
    "throttle_ratio": 0.0,
    "hub_speed_rad_s": _SPEED_NOISE_RAD_S,
    "input1_speed_rad_s": _SPEED_NOISE_RAD_S,
    "input2_speed_rad_s": _SPEED_NOISE_RAD_S,
    "clutch1_pressure_pa": _PRESSURE_NOISE_PA,
    "clutch2_pressure_pa": _PRESSURE_NOISE_PA,
    "clutch1_pressure_command_pa": 0.0,
    "clutch2_pressure_command_pa": 0.0,
    "turbine_speed_rad_s": _SPEED_NOISE_RAD_S,
    "lockup_pressure_pa": _PRESSURE_NOISE_PA,
    "lockup_pressure_command_pa": 0.0,
    "output_speed_rad_s": _SPEED_NOISE_RAD_S,
    "clutch1_torque_command_nm": 0.0,
    "clutch2_torque_command_nm": 0.0,
    "sump_temperature_k": _TEMPERATURE_NOISE_K,
    "wheel_fl_speed_m_s": _WHEEL_NOISE_M_S,
    "wheel_fr_speed_m_s": _WHEEL_NOISE_M_S,
    "wheel_rl_speed_m_s": _WHEEL_NOISE_M_S,
    "wheel_rr_speed_m_s": _WHEEL_NOISE_M_S,
    "vehicle_speed_m_s": _WHEEL_NOISE_M_S,
    "brake_pressure_pa": _PRESSURE_NOISE_PA,
    "coolant_temperature_k": _TEMPERATURE_NOISE_K,
    "ambient_temperature_k": _TEMPERATURE_NOISE_K,
    "manifold_pressure_pa": _MANIFOLD_NOISE_PA,
    "odometer_m": 0.0,
}
NOMINAL_SENSORS: Final[Sensors] = MappingProxyType(
    {quantity: Sensor(noise_std=noise_std) for quantity, noise_std in _NOISE_STD.items()}
)
STATES: Final = frozenset({
    "current_gear", "target_gear", "preselected_gear", "shift_phase", "brake_light",
    "input1_gear", "input2_gear", "drive_state", "engine_state", "lockup_state",
})  # fmt: skip
"""Quantities that a controller knows without measuring: they have no sensor errors and are never interpolated."""
SILENCE: Final = "is_silent_"  # begins the name of what says whether a sender has fallen silent; its node follows


def split_unit(quantity: str) -> tuple[str, str]:
    """Split a quantity into its stem and its unit: ``hub_speed_rad_s`` -> ``("hub_speed", "rad_s")``."""
    for unit in UNITS:
        if quantity.endswith(f"_{unit}"):
            return quantity.removesuffix(f"_{unit}"), unit
    return quantity, ""


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one named purpose; names do not disturb each other, nor does their order."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(crc32(name.encode()),)))
