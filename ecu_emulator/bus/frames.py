"""Readings become frames: SI units to the wire's, quantisation, saturation, counter and CRC; columns throughout."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from cantools.database.can import Database
from cantools.database.can.signal import Signal

from canlog.arrays import FloatArray, UInt8Array, UInt32Array
from canlog.e2e.message_contract import message_contract
from canlog.e2e.profile1 import PAYLOAD_BYTES, protect
from clutch_model import units
from ecu_emulator.sensing import Readings

UInt64Array = npt.NDArray[np.uint64]

SIGNAL_OF: Final[Mapping[str, str]] = MappingProxyType({
    "engine_speed_rad_s": "EngineSpeed",
    "engine_torque_nm": "EngineTorque",
    "pedal_ratio": "Pedal",
    "throttle_ratio": "Throttle",
    "hub_speed_rad_s": "ClutchHubSpeed",
    "input1_speed_rad_s": "InputShaft1Speed",
    "input2_speed_rad_s": "InputShaft2Speed",
    "clutch1_pressure_pa": "Clutch1Pressure",
    "clutch2_pressure_pa": "Clutch2Pressure",
    "clutch1_pressure_command_pa": "Clutch1PressureCmd",
    "clutch2_pressure_command_pa": "Clutch2PressureCmd",
    "turbine_speed_rad_s": "TurbineSpeed",
    "lockup_pressure_pa": "LockUpPressure",
    "lockup_pressure_command_pa": "LockUpPressureCmd",
    "lockup_state": "LockUpState",
    "output_speed_rad_s": "OutputSpeed",
    "clutch1_torque_command_nm": "Clutch1TorqueCmd",
    "clutch2_torque_command_nm": "Clutch2TorqueCmd",
    "current_gear": "CurrentGear",
    "target_gear": "TargetGear",
    "preselected_gear": "PreselectedGear",
    "shift_phase": "ShiftPhase",
    "input1_gear": "InputShaft1Gear",
    "input2_gear": "InputShaft2Gear",
    "drive_state": "DriveState",
    "engine_state": "EngineState",
    "sump_temperature_k": "SumpOilTemperature",
    "wheel_fl_speed_m_s": "WheelSpeedFL",
    "wheel_fr_speed_m_s": "WheelSpeedFR",
    "wheel_rl_speed_m_s": "WheelSpeedRL",
    "wheel_rr_speed_m_s": "WheelSpeedRR",
    "vehicle_speed_m_s": "VehicleSpeed",
    "brake_pressure_pa": "BrakePressure",
    "brake_light": "BrakeLight",
    "coolant_temperature_k": "CoolantTemperature",
    "ambient_temperature_k": "AmbientTemperature",
    "manifold_pressure_pa": "ManifoldPressure",
    "odometer_m": "Odometer",
})  # fmt: skip
"""The signal that carries each quantity; the unit that ends the quantity's name and the signal's match by kind."""

QUANTITY_OF: Final[Mapping[str, str]] = {signal: quantity for quantity, signal in SIGNAL_OF.items()}

UNITS: Final[Mapping[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]]] = {  # of signals: from SI, to SI
    "rpm": (units.rpm_from_rad_s, units.rad_s_from_rpm),
    "bar": (units.bar_from_pa, units.pa_from_bar),
    "kPa": (lambda pressure_pa: pressure_pa / 1e3, lambda pressure_kpa: pressure_kpa * 1e3),
    "degC": (units.degc_from_k, units.k_from_degc),
    "km/h": (units.km_h_from_m_s, units.m_s_from_km_h),
    "%": (lambda ratio: ratio * 100.0, lambda percent: percent / 100.0),
    **dict.fromkeys(("Nm", "m", ""), (lambda value: value, lambda value: value)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodedFrames:
    """Frames in the order they are sent, as arrays."""

    t_s: FloatArray  # (n,) scenario time
    can_id: UInt32Array  # (n,)
    length: UInt8Array  # (n,)
    data: UInt8Array  # (n, 8)

    def __len__(self) -> int:
        return len(self.t_s)

    def __getitem__(self, rows: slice | npt.NDArray[np.int64]) -> "EncodedFrames":
        return EncodedFrames(
            t_s=self.t_s[rows], can_id=self.can_id[rows], length=self.length[rows], data=self.data[rows]
        )


@dataclass(frozen=True, slots=True)
class _SignalCode:
    """How one quantity is written into its message."""

    quantity: str
    start_bit: int
    from_si: Callable[[FloatArray], FloatArray]
    scale: float
    offset: float
    raw_limits: tuple[float, float]
    not_available: int

    def raw(self, si: FloatArray) -> UInt64Array:
        """Return the raw values, limited to their range; NaN becomes the code for not available."""
        steps = np.rint((self.from_si(si) - self.offset) / self.scale)
        return np.where(np.isnan(steps), self.not_available, np.clip(steps, *self.raw_limits)).astype(np.uint64)


class FrameEncoder:
    """Writes the messages of the wire contract; alive counters continue from call to call."""

    def __init__(self, database: Database) -> None:
        self._contracts = {message.name: message_contract(message) for message in database.messages}
        self._signals = {
            message.name: [_signal_code(message.get_signal_by_name(name)) for name in message_contract(message).signals]
            for message in database.messages
        }
        self._next_counter = dict.fromkeys(self._contracts, 0)

    def restart(self) -> None:
        """Let the alive counters begin at 0, as after the ignition was off."""
        self._next_counter = dict.fromkeys(self._contracts, 0)

    def quantities(self, message: str) -> tuple[str, ...]:
        """Return the names of the quantities that a message carries."""
        return tuple(signal.quantity for signal in self._signals[message])

    def encode(self, readings: Readings) -> EncodedFrames:
        """Return the frames of one message, one per reading of all quantities it carries [SI]; NaN: not available."""
        contract, count = self._contracts[readings.message], len(readings.t_s)
        word = np.zeros(count, np.uint64)
        for signal in self._signals[readings.message]:
            word |= signal.raw(readings.values[signal.quantity]) << np.uint64(signal.start_bit)
        payloads = word.astype("<u8").view(np.uint8).reshape(-1, PAYLOAD_BYTES)
        counter = self._next_counter[readings.message] + np.arange(count)
        self._next_counter[readings.message] += count
        return EncodedFrames(
            t_s=np.asarray(readings.t_s, np.float64),
            can_id=np.full(count, contract.can_id, np.uint32),
            length=np.full(count, PAYLOAD_BYTES, np.uint8),
            data=protect(payloads, contract.data_id or 0, counter),
        )

    def encode_all(self, readings: Iterable[Readings]) -> EncodedFrames:
        """Return the frames of several messages in the order of transmission."""
        return merge([self.encode(of_message) for of_message in readings])


_NO_FRAMES: Final = EncodedFrames(
    t_s=np.empty(0),
    can_id=np.empty(0, np.uint32),
    length=np.empty(0, np.uint8),
    data=np.empty((0, PAYLOAD_BYTES), np.uint8),
)


def joined(*parts: EncodedFrames) -> EncodedFrames:
    """Return the frames of all parts, one after the other."""
    return EncodedFrames(
        **{
            column.name: np.concatenate([getattr(part, column.name) for part in parts])
            for column in fields(EncodedFrames)
        }
    )


def merge(parts: Sequence[EncodedFrames]) -> EncodedFrames:
    """Return all frames in the order of time; at the same instant the lower identifier wins, as in arbitration."""
    frames = joined(_NO_FRAMES, *parts)
    return frames[np.lexsort((frames.can_id, frames.t_s))]


def _signal_code(signal: Signal) -> _SignalCode:
    """Compile one signal: unsigned, little-endian, its highest raw value says not available."""
    low, high = (float(physical or 0.0) for physical in (signal.minimum, signal.maximum))
    return _SignalCode(
        quantity=QUANTITY_OF[signal.name],
        start_bit=signal.start,
        from_si=UNITS[signal.unit or ""][0],
        scale=signal.scale,
        offset=signal.offset,
        raw_limits=(round((low - signal.offset) / signal.scale), round((high - signal.offset) / signal.scale)),
        not_available=2**signal.length - 1,
    )
