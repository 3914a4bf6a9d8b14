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
from canlog.jit import kernel
from clutch_model.calibration import Calibration, clutch_of_gear
from clutch_model.pack import gear_clutch
from diag_service.diagnosis.columns import DriveState, Signal
from diag_service.diagnosis.shifts.history import History
from diag_service.diagnosis.shifts.tracking import compile_now, hold

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
        compile_now()
        self._changes(np.empty(0, np.int64), np.empty(0), np.empty((len(self._held), 0)))

    def forget(self) -> None:
        self._last = [math.nan] * len(self._held)
        self._doing = np.full(_STATE_SIZE, _NOTHING_YET)
        self._rows = np.empty((1 + _LOADS_ROW, 0))  # engine and shafts, in the last rows of a table

    def track(self, history: History, until_ns: int) -> list[GripChange]:
        engine = history.ahead(self._signals.engine, until_ns)
        held = np.empty((len(self._held), len(engine.t_ns)))
        for row, signal in enumerate(self._held):
            series = history.ahead(signal, until_ns)
            hold(series.t_ns, series.value, engine.t_ns, self._last[row], held[row])
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
        rows, states = np.empty(len(t_ns), np.int64), np.empty((len(t_ns), _STATE_SIZE), np.int64)
        above, are_shared = self._signals.loaded_above, self._signals.are_shared
        count = find_changes(engine_rad_s, held, above, are_shared, self._doing, rows, states)
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
            for row, (grip, gear_grip, gear, asked) in zip(rows[:count].tolist(), states[:count].tolist(), strict=True)
        ]


@kernel
def find_changes(
    engine_rad_s: FloatArray,
    held: FloatArray,
    above: tuple[float, float],
    are_shared: bool,  # noqa: FBT001 - a compiled function
    doing: Int64Array,
    rows: Int64Array,
    states: Int64Array,
) -> int:
    """Fill in in which rows what the clutches do, or what the driver asks for, becomes something else, and what.

    Return how often it does. ``doing`` is what it was before, and becomes what it is at the end. An unknown value tells
    neither of slip nor of load.
    """
    count = 0
    for row in range(len(engine_rad_s)):
        gear = 0 if np.isnan(held[_GEAR_ROW, row]) else int(held[_GEAR_ROW, row])
        own = gear_clutch(gear) - 1
        any_grip, gear_grip = _OPEN, _OPEN
        for clutch in range(2):
            if held[_LOADS_ROW + clutch, row] > above[clutch] and (clutch == own or not are_shared):
                slips = abs(engine_rad_s[row] - held[_SHAFTS_ROW + clutch, row]) > SLIP_RAD_S
                grip = _SLIPPING if slips else _LOCKED
                any_grip = max(any_grip, grip)
                gear_grip = grip if clutch == own and gear >= 1 else gear_grip
        asked = _asked(held[_PEDAL_ROW, row], held[_STATE_ROW, row])
        if any_grip != doing[0] or gear_grip != doing[1] or gear != doing[2] or asked != doing[3]:
            doing[0], doing[1], doing[2], doing[3] = any_grip, gear_grip, gear, asked
            rows[count] = row
            for part in range(len(doing)):
                states[count, part] = doing[part]
            count += 1
    return count


@kernel
def _asked(pedal_ratio: float, drive_state: float) -> int:
    """Return whether the driver asks for force, 1 or 0; -1 while unknown. The transmission's own word counts first."""
    if drive_state == _CREEPING:
        return 0
    return -1 if np.isnan(pedal_ratio) else int(pedal_ratio > PEDAL_RATIO)
