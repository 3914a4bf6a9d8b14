"""Signals as columns of samples: what the decoder makes of frames, and what every later stage reads.

SI units, radians, kelvin and pascal throughout. Times are bus times in integer nanoseconds since the epoch, or since
whatever a log counts from: below zero they are as good as above.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.e2e_state import E2eChange


class Signal(StrEnum):
    """Canonical signals; the unit is the end of the name. A mapping profile fills them from a DBC."""

    ENGINE_SPEED = "engine_speed_rad_s"  # mean over the last crank segment
    ENGINE_TORQUE = "engine_torque_nm"  # at the crankshaft, friction deducted
    ENGINE_TORQUE_COMMAND = "engine_torque_command_nm"
    INJECTION_TIME = "injection_time_s"  # of an injector in a working cycle: torque up to a scale, where none is told
    PEDAL = "pedal_ratio"
    THROTTLE = "throttle_ratio"
    HUB_SPEED = "hub_speed_rad_s"
    INPUT1_SPEED = "input1_speed_rad_s"
    INPUT2_SPEED = "input2_speed_rad_s"
    INPUT_SPEED = "input_speed_rad_s"  # of the shaft that carries the gear, where the bus has one for both clutches
    TURBINE_SPEED = "turbine_speed_rad_s"  # behind a torque converter
    OUTPUT_SPEED = "output_speed_rad_s"
    CLUTCH1_PRESSURE = "clutch1_pressure_pa"
    CLUTCH2_PRESSURE = "clutch2_pressure_pa"
    LOCKUP_PRESSURE = "lockup_pressure_pa"
    LOCKUP_PRESSURE_COMMAND = "lockup_pressure_command_pa"  # commanded or computed: its lag and scale are not known
    LOCKUP_SLIP = "lockup_slip_rad_s"  # engine less turbine, as the transmission controller states it
    LOCKUP_SLIP_COMMAND = "lockup_slip_command_rad_s"  # that the controller regulates to
    LINE_PRESSURE_COMMAND = "line_pressure_command_pa"
    CLUTCH1_PRESSURE_COMMAND = "clutch1_pressure_command_pa"
    CLUTCH2_PRESSURE_COMMAND = "clutch2_pressure_command_pa"
    CLUTCH1_TORQUE_COMMAND = "clutch1_torque_command_nm"
    CLUTCH2_TORQUE_COMMAND = "clutch2_torque_command_nm"
    CLUTCH_TORQUE = "clutch_torque_nm"  # of both clutches together, as the transmission controller states it
    CLUTCH_SLIP = "clutch_slip_ratio"  # of engine speed, as the transmission controller states it
    CURRENT_GEAR = "current_gear"
    TARGET_GEAR = "target_gear"
    PRESELECTED_GEAR = "preselected_gear"
    SHIFT_PHASE = "shift_phase"
    SHIFT_ACTIVE = "shift_active"  # 1 while a change of gear is in progress, as the transmission controller says
    INPUT1_GEAR = "input1_gear"  # that input shaft 1 has engaged, 0 for none
    INPUT2_GEAR = "input2_gear"
    DRIVE_STATE = "drive_state"  # a number of `DriveState`
    ENGINE_STATE = "engine_state"  # a number of `EngineState`
    SUMP_TEMPERATURE = "sump_temperature_k"
    COOLANT_TEMPERATURE = "coolant_temperature_k"  # of the engine
    WHEEL_FL_SPEED = "wheel_fl_speed_m_s"
    WHEEL_FR_SPEED = "wheel_fr_speed_m_s"
    WHEEL_RL_SPEED = "wheel_rl_speed_m_s"
    WHEEL_RR_SPEED = "wheel_rr_speed_m_s"
    VEHICLE_SPEED = "vehicle_speed_m_s"
    BRAKE_PRESSURE = "brake_pressure_pa"
    ODOMETER = "odometer_m"
    AMBIENT_TEMPERATURE = "ambient_temperature_k"


BALANCE_SIGNALS = (
    Signal.ENGINE_SPEED,
    Signal.ENGINE_TORQUE,
    Signal.HUB_SPEED,
    Signal.INPUT1_SPEED,
    Signal.INPUT2_SPEED,
    Signal.CLUTCH1_PRESSURE,
    Signal.CLUTCH2_PRESSURE,
)
"""What the torque balance of the input side needs, sample by sample."""

LOCKUP_SIGNALS = frozenset({Signal.ENGINE_SPEED, Signal.ENGINE_TORQUE, Signal.TURBINE_SPEED, Signal.LOCKUP_PRESSURE})
"""What the level of friction of the lock-up clutch of a converter needs."""

SLIP_SIGNALS = frozenset(
    {Signal.LOCKUP_PRESSURE, Signal.LOCKUP_PRESSURE_COMMAND, Signal.LOCKUP_SLIP, Signal.LOCKUP_SLIP_COMMAND}
)
"""What only a vehicle with a lock-up clutch has."""

SUMMED_SIGNALS = frozenset({Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP})
"""Whose sum is engine speed, where nothing else tells it."""


ROW_SIGNALS = (Signal.ENGINE_SPEED, Signal.INPUT1_SPEED, Signal.CLUTCH1_PRESSURE)
"""What no bus has in one message: if they have the same times, these are the rows of a table."""


class DriveState(IntEnum):
    """What the transmission does with the engine's torque, as it says itself."""

    IN_GEAR = 0
    CHANGING = 1
    STANDSTILL = 2
    CREEPING = 3
    LAUNCHING = 4
    COASTING_OPEN = 5


class EngineState(IntEnum):
    """What the engine does, as its controller says."""

    FIRING = 0
    FUEL_CUT = 1  # turned by the car
    STOPPED = 2
    CRANKING = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class GearRatios:
    """Engine speed over another speed in every gear, where no signal tells the gear."""

    over: Signal  # output speed [rad/s] or vehicle speed [m/s]
    ratios: tuple[float, ...]  # first gear first; dimensionless, or [rad/m]


Columns = Mapping[Signal, Series]
NO_SAMPLES: Final = Series(t_ns=np.empty(0, np.int64), sequence=np.empty(0, np.int64), value=np.empty(0))


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnBatch:
    """Decoded columns of one batch of frames.

    ``watermark_ns`` is the time of the last frame of the batch, of whatever kind: all that happened before it has
    been seen. ``breaks_before`` says that bus time jumped: what came earlier is another segment.
    """

    columns: Columns
    watermark_ns: int
    breaks_before: bool = False
    bad_frame_ns: Int64Array = field(default_factory=lambda: np.empty(0, np.int64))  # (m,) rejected or missing
    e2e_changes: tuple[E2eChange, ...] = ()  # of each message in the order of time


class ColumnSamples(NamedTuple):
    """Samples of k signals, each row filled from its beginning."""

    filled: Int64Array  # (k,) where each row ends
    t_ns: Int64Array  # (k, n)
    sequence: Int64Array  # (k, n)
    value: FloatArray  # (k, n)


class BlockLayout:
    """Which signal is in which row of a block, and how often it comes."""

    def __init__(self, signals: Sequence[Signal], period_ns: Sequence[int]) -> None:
        self.signals = tuple(signals)
        self.period_ns = tuple(period_ns)
        self.row = {signal: row for row, signal in enumerate(signals)}

    def room(self, size: int) -> ColumnSamples:
        """Return empty rows for ``size`` samples of each signal."""
        shape = len(self.signals), size
        return ColumnSamples(
            filled=np.zeros(len(self.signals), np.int64),
            t_ns=np.empty(shape, np.int64),
            sequence=np.empty(shape, np.int64),
            value=np.empty(shape),
        )


class SampleBlock(Mapping[Signal, Series]):
    """Columns that are made into series when somebody asks for them; signals without a sample are not among them."""

    __slots__ = ("layout", "samples")

    def __init__(self, layout: BlockLayout, samples: ColumnSamples) -> None:
        self.layout = layout
        self.samples = samples

    def __getitem__(self, signal: Signal) -> Series:
        row = self.layout.row[signal]
        count = self.samples.filled[row]
        if not count:
            raise KeyError(signal)
        return Series(
            t_ns=self.samples.t_ns[row, :count],
            sequence=self.samples.sequence[row, :count],
            value=self.samples.value[row, :count],
            period_ns=self.layout.period_ns[row],
        )

    def __iter__(self) -> Iterator[Signal]:
        counts = self.samples.filled.tolist()
        return iter([signal for signal, count in zip(self.layout.signals, counts, strict=True) if count])

    def __len__(self) -> int:
        return int(np.count_nonzero(self.samples.filled))
