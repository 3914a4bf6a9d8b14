"""Whether a clutch slips under load, walked along the samples: what launches and the ends of shifts are told by.

Slip is hub (or engine) less input shaft. Load is piston pressure above the touch point where pressures are measured,
else the torque that is asked of a clutch.
"""

import math
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import share_rows
from clutch_model.calibration import Calibration, clutch_of_gear
from diag_service.diagnosis.columns import DriveState, Signal
from diag_service.diagnosis.shifts.history import History
from diag_service.diagnosis.shifts.tracking import held_values

SLIP_RAD_S: Final = 5.0  # 50 rpm: beyond it a clutch slips, whatever two controllers' speeds differ by
ROWS_APART: Final = 2.0  # times what a speed changed from row to row lately: it may change faster until the next one
HELD_ROWS: Final = 4  # a value may be held for so many
LOADED_PA: Final = 0.15e5  # above the touch point: three times what touch point and zero are known to
LOADED_NM: Final = 5.0  # asked for: what is less does not move a car
PEDAL_RATIO: Final = 0.02  # beyond it a foot is on the pedal, below it may be the zero of its sensor
PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
_TORQUES: Final = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_TORQUE: Final = (Signal.CLUTCH_TORQUE, Signal.CLUTCH_TORQUE)
SHAFTS: Final = (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)
_SHAFT: Final = (Signal.INPUT_SPEED, Signal.INPUT_SPEED)

_SHAFTS_ROW: Final = 0  # of held values, and what follows: where the signals of both clutches begin, or one stands
_LOADS_ROW: Final = 2
_GEAR_ROW: Final = 4
_PEDAL_ROW: Final = 5
_STATE_ROW: Final = 6
_STATE_SIZE: Final = 4  # grip, grip of the gear's clutch, gear, whether force is asked for
_NOTHING_YET: Final = -2


class Grip(IntEnum):
    """What the clutches do."""

    OPEN = 0  # no clutch is loaded
    LOCKED = 1  # a clutch is loaded, and none that is slips
    SLIPPING = 2  # a clutch slips under load


_OPEN, _LOCKED, _SLIPPING = (int(one) for one in Grip)  # compiled functions know no enumerations
_CREEPING: Final = int(DriveState.CREEPING)


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
    def held(self) -> tuple[Signal, ...]:
        """All signals but that of the engine's side, those that may be missing included, in the order of their rows."""
        return (*self.shafts, *self.loads, self.gear, Signal.PEDAL, Signal.DRIVE_STATE)

    @property
    def are_shared(self) -> bool:
        """Whether one signal stands for both clutches: it speaks of that of the gear."""
        return self.loads[0] is self.loads[1] or self.shafts[0] is self.shafts[1]


def slip_signals(signals: AbstractSet[Signal], calibration: Calibration) -> SlipSignals | None:
    """Return where slip and load are told, or None if they are not."""
    first, second = (clutch.touch_pressure_pa + LOADED_PA for clutch in calibration.clutches)
    engine = next((one for one in (Signal.HUB_SPEED, Signal.ENGINE_SPEED) if one in signals), None)
    shafts = next((pair for pair in (SHAFTS, _SHAFT) if signals >= set(pair)), None)
    loads = next((pair for pair in (PRESSURES, _TORQUES, _TORQUE) if signals >= set(pair)), None)
    gear = next((one for one in (Signal.CURRENT_GEAR, Signal.TARGET_GEAR) if one in signals), None)
    if engine is None or shafts is None or loads is None or gear is None:
        return None
    above = (first, second) if loads is PRESSURES else (LOADED_NM, LOADED_NM)
    return SlipSignals(engine=engine, shafts=shafts, loads=loads, loaded_above=above, gear=gear)


class SlipTracker:
    """Walks the samples of the engine's side, in steps of any size, and reports what changes."""

    def __init__(self, signals: SlipSignals) -> None:
        self._signals = signals
        self._held = signals.held
        self.forget()

    def forget(self) -> None:
        self._last = [math.nan] * len(self._held)
        self._doing = np.full((_STATE_SIZE, 1), _NOTHING_YET)
        self._rows = np.empty((1 + _LOADS_ROW, 0))  # engine and shafts, in the last rows of a table

    def track(self, history: History, until_ns: int) -> list[GripChange]:
        engine = history.ahead(self._signals.engine, until_ns)
        held = np.empty((len(self._held), len(engine.t_ns)))
        for row, signal in enumerate(self._held):
            series = history.ahead(signal, until_ns)
            held[row] = held_values(series, engine.t_ns, self._last[row])
            if len(series.value):
                self._last[row] = float(series.value[-1])
        if len(engine.t_ns) and engine.sequence[0] < 0:
            self._forgive_rows(history, engine, held, until_ns)
        return self._changes(engine.t_ns, engine.value, held)

    def _forgive_rows(self, history: History, engine: Series, held: FloatArray, until_ns: int) -> None:
        """Take for locked what the columns of a table, asked one after the other, may be apart within a row."""
        others = [history.ahead(one, until_ns) for one in (self._signals.shafts[0], self._signals.loads[0])]
        rows = np.hstack([self._rows, np.vstack([engine.value, held[:_LOADS_ROW]])])
        before, self._rows = self._rows.shape[1], rows[:, -HELD_ROWS - 1 :].copy()
        if not share_rows([engine, *others]):
            return
        changes_rad_s = np.nan_to_num(np.abs(np.diff(rows, prepend=rows[:, :1])))
        changing_rad_s = np.max(
            [np.pad(changes_rad_s, ((0, 0), (back, 0)))[:, : rows.shape[1]] for back in range(HELD_ROWS)], axis=0
        )[:, before:]
        for shaft, changing in zip(held[:_LOADS_ROW], changing_rad_s[1:], strict=True):
            apart_rad_s = ROWS_APART * np.maximum(changing, changing_rad_s[0])
            is_locked = np.abs(engine.value - shaft) < apart_rad_s
            shaft[is_locked] = engine.value[is_locked]

    def _changes(self, t_ns: Int64Array, engine_rad_s: FloatArray, held: FloatArray) -> list[GripChange]:
        states = _states(engine_rad_s, held, self._signals.loaded_above, are_shared=self._signals.are_shared)
        since = np.hstack([self._doing, states])
        self._doing = since[:, -1:]
        rows = np.flatnonzero((since[:, 1:] != since[:, :-1]).any(axis=0))
        return [
            GripChange(
                t_ns=int(t_ns[row]),
                grip=Grip(grip),
                gear_grip=Grip(gear_grip),
                gear=gear,
                is_asked=None if asked < 0 else bool(asked),
                engine_rad_s=float(engine_rad_s[row]),
                shaft_rad_s=float(held[_SHAFTS_ROW + clutch_of_gear(gear) - 1, row]),
            )
            for row, (grip, gear_grip, gear, asked) in zip(rows.tolist(), states[:, rows].T.tolist(), strict=True)
        ]


def _states(engine_rad_s: FloatArray, held: FloatArray, above: tuple[float, float], *, are_shared: bool) -> Int64Array:
    """Return what the clutches do and what the driver asks for, shape (_STATE_SIZE, n).

    An unknown value tells neither of slip nor of load. Whether force is asked for is -1 while unknown; the
    transmission's own word counts first.
    """
    gear = np.nan_to_num(held[_GEAR_ROW]).astype(np.int64)
    is_of_gear = clutch_of_gear(gear) == np.array([[1], [2]])
    is_loaded = held[_LOADS_ROW:_GEAR_ROW] > np.array(above)[:, np.newaxis]
    if are_shared:
        is_loaded &= is_of_gear
    slips = np.abs(engine_rad_s - held[_SHAFTS_ROW:_LOADS_ROW]) > SLIP_RAD_S
    grips = np.where(is_loaded, np.where(slips, _SLIPPING, _LOCKED), _OPEN)
    gear_grip = np.where(is_of_gear & (gear >= 1), grips, _OPEN).max(axis=0)
    pedal_ratio = held[_PEDAL_ROW]
    asked = np.where(np.isnan(pedal_ratio), -1, pedal_ratio > PEDAL_RATIO)
    asked[held[_STATE_ROW] == _CREEPING] = 0
    return np.stack([grips.max(axis=0), gear_grip, gear, asked])
