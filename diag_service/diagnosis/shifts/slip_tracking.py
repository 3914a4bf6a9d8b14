"""Whether a clutch slips under load, walked along the samples: what launches and the ends of shifts are told by.

Slip is hub (or engine) less input shaft. Load is piston pressure above the touch point where pressures are measured,
else the torque that is asked of a clutch.
"""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, TypeVar

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from clutch_model.calibration import Calibration
from clutch_model.gears import both_clutches, clutch_of_gear
from diag_service.diagnosis.columns import DriveState, Signal
from diag_service.diagnosis.shifts.history import History
from diag_service.diagnosis.shifts.tracking import held_values

SLIP_RAD_S: Final = 5.0  # 50 rpm: beyond it a clutch slips, whatever two controllers' speeds differ by
LOADED_PA: Final = 0.15e5  # above the touch point: three times what touch point and zero are known to
LOADED_NM: Final = 5.0  # asked for: what is less does not move a car
PEDAL_RATIO: Final = 0.02  # beyond it a foot is on the pedal, below it may be the zero of its sensor

Values = TypeVar("Values", BoolArray, FloatArray)
_PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
_TORQUES: Final = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_TORQUE: Final = (Signal.CLUTCH_TORQUE, Signal.CLUTCH_TORQUE)
_SHAFTS: Final = (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)
_SHAFT: Final = (Signal.INPUT_SPEED, Signal.INPUT_SPEED)


class Grip(IntEnum):
    """What the clutches do."""

    OPEN = 0  # no clutch is loaded
    LOCKED = 1  # a clutch is loaded, and none that is slips
    SLIPPING = 2  # a clutch slips under load


@dataclass(frozen=True, slots=True)
class GripChange:
    """From when on the clutches do something else, or the driver asks for something else."""

    t_ns: int
    grip: Grip  # of both clutches: one may be filled for the next gear while the other one carries
    gear_grip: Grip  # of the clutch of the gear alone
    gear: int  # 0 where no gear is known
    is_asked: bool | None  # whether the car shall be set in motion; None: unknown
    engine_rad_s: float
    shaft_rad_s: float  # of the gear


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipSignals:
    """Where a bus tells of slip and load."""

    engine: Signal
    shafts: tuple[Signal, Signal]
    loads: tuple[Signal, Signal]
    loaded_above: tuple[float, float]  # in the unit of the loads
    gear: Signal

    @property
    def others(self) -> tuple[Signal, ...]:
        """All signals but that of the engine's side, those that may be missing included."""
        return tuple(dict.fromkeys((*self.shafts, *self.loads, self.gear, Signal.PEDAL, Signal.DRIVE_STATE)))


def slip_signals(signals: AbstractSet[Signal], calibration: Calibration) -> SlipSignals | None:
    """Return where slip and load are told, or None if they are not."""
    first, second = (clutch.touch_pressure_pa + LOADED_PA for clutch in calibration.clutches)
    engine = next((one for one in (Signal.HUB_SPEED, Signal.ENGINE_SPEED) if one in signals), None)
    shafts = next((pair for pair in (_SHAFTS, _SHAFT) if signals >= set(pair)), None)
    loads = next((pair for pair in (_PRESSURES, _TORQUES, _TORQUE) if signals >= set(pair)), None)
    gear = next((one for one in (Signal.CURRENT_GEAR, Signal.TARGET_GEAR) if one in signals), None)
    if engine is None or shafts is None or loads is None or gear is None:
        return None
    above = (first, second) if loads is _PRESSURES else (LOADED_NM, LOADED_NM)
    return SlipSignals(engine=engine, shafts=shafts, loads=loads, loaded_above=above, gear=gear)


class SlipTracker:
    """Walks the samples of the engine's side, in steps of any size, and reports what changes."""

    def __init__(self, signals: SlipSignals) -> None:
        self._signals = signals
        self.forget()

    def forget(self) -> None:
        """Forget all values: another segment begins."""
        self._last = dict.fromkeys(self._signals.others, np.nan)
        self._before: tuple[int, ...] | None = None

    def track(self, history: History, until_ns: int) -> list[GripChange]:
        """Walk the samples with ``t < until_ns``."""
        engine = history.ahead(self._signals.engine, until_ns)
        values = {}
        for signal in self._signals.others:
            series = history.ahead(signal, until_ns)
            values[signal] = held_values(series, engine.t_ns, self._last[signal])
            if len(series.value):
                self._last[signal] = float(series.value[-1])
        if not len(engine.t_ns):
            return []
        return self._changes(engine.t_ns, engine.value, values)

    def _changes(
        self, t_ns: Int64Array, engine_rad_s: FloatArray, values: Mapping[Signal, FloatArray]
    ) -> list[GripChange]:
        gear = np.nan_to_num(values[self._signals.gear]).astype(np.int64)
        slips, loads = self._slips(engine_rad_s, values, gear)
        grip = _grip(slips[0] | slips[1], loads[0] | loads[1])
        gear_grip = np.where(gear >= 1, _grip(_of_gear(gear, slips), _of_gear(gear, loads)), Grip.OPEN)
        asked = _asked(values)
        shafts = both_clutches(values[shaft] for shaft in self._signals.shafts)
        shaft_rad_s = _of_gear(gear, shafts)
        state = np.column_stack((grip, gear_grip, gear, asked))
        before = np.vstack((self._before or (-1, -1, -1, -2), state[:-1]))
        rows = np.flatnonzero((state != before).any(axis=1)).tolist()
        self._before = tuple(state[-1].tolist())
        return [
            GripChange(
                t_ns=int(t_ns[row]),
                grip=Grip(int(grip[row])),
                gear=int(gear[row]),
                is_asked=None if asked[row] < 0 else bool(asked[row]),
                gear_grip=Grip(int(gear_grip[row])),
                engine_rad_s=float(engine_rad_s[row]),
                shaft_rad_s=float(shaft_rad_s[row]),
            )
            for row in rows
        ]

    def _slips(
        self, engine_rad_s: FloatArray, values: Mapping[Signal, FloatArray], gear: Int64Array
    ) -> tuple[tuple[BoolArray, BoolArray], tuple[BoolArray, BoolArray]]:
        """Return which clutches slip under load, and which are loaded; an unknown value tells of neither."""
        signals = self._signals
        loads = both_clutches(
            values[load] > above for load, above in zip(signals.loads, signals.loaded_above, strict=True)
        )
        slips = both_clutches(np.abs(engine_rad_s - values[shaft]) > SLIP_RAD_S for shaft in signals.shafts)
        if signals.loads[0] is signals.loads[1] or signals.shafts[0] is signals.shafts[1]:
            is_first = clutch_of_gear(gear) == 1  # one signal for both clutches speaks of that of the gear
            loads = loads[0] & is_first, loads[1] & ~is_first
        return (loads[0] & slips[0], loads[1] & slips[1]), loads


def _asked(values: Mapping[Signal, FloatArray]) -> Int64Array:
    """Return whether the driver asks for force, 1 or 0; -1 while unknown. The transmission's own word counts first."""
    pedal, state = values[Signal.PEDAL], values[Signal.DRIVE_STATE]
    by_pedal = np.where(np.isnan(pedal), -1, pedal > PEDAL_RATIO)
    return np.where(state == DriveState.CREEPING, 0, by_pedal).astype(np.int64)


def _grip(slips: BoolArray, is_loaded: BoolArray) -> Int64Array:
    """Return the numbers of the grips, shape (n,)."""
    return np.where(slips, Grip.SLIPPING, np.where(is_loaded, Grip.LOCKED, Grip.OPEN))


def _of_gear(gear: Int64Array, both: tuple[Values, Values]) -> Values:
    """Return what the clutch of the gear has, sample by sample, of what both have."""
    return np.where(clutch_of_gear(gear) == 1, *both)
