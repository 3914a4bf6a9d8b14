"""The slip of a gear change as blind prediction takes it: engine speed, pressures and load from the handover on."""

from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from clutch_model.calibration import clutch_of_gear
from clutch_model.units import NS_PER_S
from clutch_results.records import Reason
from diag_service.diagnosis.columns import NO_SAMPLES, ColumnBatch, GearRatios, Signal
from diag_service.diagnosis.events import Event

LEFT_OLD_GEAR: Final = 0.08  # of the step between the gears: by so much the engine has left the old one
LEFT_SCATTER, MOST_LEFT = 2.0, 0.3  # or by so many times the scatter of the rows before, up to this part of the step
HANDED_OVER: Final = 0.4  # of the off-going clutch's pressure: with so much the on-coming one begins to take over
LEAST_ROWS: Final = 2  # samples of engine speed in a slip phase, its first included
OPEN_RATIO: Final = 0.05  # of throttle, pedal: beyond it the engine drives
TORQUE_SOURCES: Final = (Signal.ENGINE_TORQUE, Signal.INJECTION_TIME)
PEDALS: Final = (Signal.PEDAL, Signal.THROTTLE)
PRESSURES: Final = {1: Signal.CLUTCH1_PRESSURE, 2: Signal.CLUTCH2_PRESSURE}
INPUTS: Final = {1: Signal.INPUT1_SPEED, 2: Signal.INPUT2_SPEED}
STANDING_RAD_S: Final = 0.5  # of the output shaft: slower, the car stands
HELD_PA: Final = 0.3e5  # what is less is an empty piston, not a clutch that is held at its touch point


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipPhase:
    """A shift from the last sample in its old gear to the last one before its on-coming clutch locks.

    ``t_s`` counts from the first of ``speed_rad_s``; the pressures and ``drive`` (what tells the torque, 1 where
    nothing does) have times of their own around it, (n, 2) arrays of time and value.
    """

    number: int
    from_gear: int
    to_gear: int
    is_powered: bool
    start_ns: int
    t_s: FloatArray
    speed_rad_s: FloatArray
    slip_rad_s: FloatArray  # of the on-coming clutch
    on_pa: FloatArray
    off_pa: FloatArray
    drive: FloatArray

    @property
    def clutch(self) -> int:
        """The on-coming clutch: 1 carries the odd gears."""
        return clutch_of_gear(self.to_gear)

    @property
    def sign(self) -> float:
        """1 where the engine is faster than the new gear asks, as in an upshift; -1 where it is slower."""
        return 1.0 if self.slip_rad_s[0] > 0.0 else -1.0

    @property
    def change_rad_s(self) -> FloatArray:
        """Change of engine speed since the first sample, at every later one."""
        change: FloatArray = self.speed_rad_s[1:] - self.speed_rad_s[0]
        return change

    @property
    def mean_pa(self) -> float:
        """Mean pressure of the on-coming clutch."""
        return float(np.interp(self.t_s, *self.on_pa.T).mean())

    @property
    def course(self) -> FloatArray:
        """What a shift is like: mean pressure [Pa], first slip [rad/s], mean of what tells the torque; (3,)."""
        return np.array([self.mean_pa, np.abs(self.slip_rad_s[0]), np.interp(self.t_s, *self.drive.T).mean()])


class NoPhase(NamedTuple):
    """A gear change that cannot be predicted, and why."""

    event: Event
    reason: str


def slip_phase(event: Event, gears: GearRatios | None = None) -> SlipPhase | NoPhase:
    """Return the slip phase of a gear change, from speeds alone, or why there is none."""
    columns = event.columns
    missing = [
        signal.value
        for signal in (Signal.ENGINE_SPEED, *PRESSURES.values())
        if not len(columns.get(signal, NO_SAMPLES).t_ns)
    ]
    if event.from_gear == event.to_gear or min(event.from_gear, event.to_gear) < 1:
        return NoPhase(event, "no change from gear to gear")
    if missing or event.has_whole_seconds:
        return NoPhase(event, f"no {', '.join(missing)}" if missing else Reason.WHOLE_SECONDS.replace("_", " "))
    engine = columns[Signal.ENGINE_SPEED]
    inputs = _input_speeds(event, engine.t_ns, gears)
    if inputs is None:
        return NoPhase(event, "neither speeds behind the clutches nor ratios and a speed behind the gears")
    on_slip, off_slip = engine.value - inputs[0], engine.value - inputs[1]
    step = float(np.median((inputs[1] - inputs[0])[:3]))
    is_before = engine.t_ns < event.start_ns
    scatter = 1.4826 * float(np.median(np.abs(off_slip[is_before]))) if is_before.any() else 0.0
    least = min(max(LEFT_OLD_GEAR * abs(step), LEFT_SCATTER * scatter), MOST_LEFT * abs(step))
    has_left = (off_slip * -np.sign(step) > least) & ~is_before
    if not has_left.any() or has_left[0]:
        return NoPhase(event, "the engine never leaves the old gear")
    locked = np.flatnonzero((on_slip * np.sign(step) <= 0.0) & (np.cumsum(has_left) > 0))
    stop = int(locked[0]) if len(locked) else len(on_slip)
    # Rows scatter: one that seems to have left is not the beginning while a later one is in the old gear, or while the
    # on-coming clutch has no pressure.
    clutch = clutch_of_gear(event.to_gear)
    both = (columns[PRESSURES[which]] for which in (clutch, 3 - clutch))
    on_pa, off_pa = (np.interp(engine.t_ns, pressure.t_ns, pressure.value) for pressure in both)
    takes_over = on_pa > HANDED_OVER * np.maximum(off_pa, HELD_PA)
    first = int(np.flatnonzero(~(has_left & takes_over)[:stop])[-1])
    if not len(locked) or stop - first < LEAST_ROWS:
        return NoPhase(event, f"not enough samples in the slip ({stop - first} of at least {LEAST_ROWS})")
    start_ns = int(engine.t_ns[first])
    t_s = (engine.t_ns[first:stop] - start_ns) / NS_PER_S
    source = next(
        (columns[signal] for signal in TORQUE_SOURCES if signal in columns and len(columns[signal].t_ns)), None
    )
    pedals = [columns[signal].value for signal in PEDALS if signal in columns and len(columns[signal].t_ns)]
    return SlipPhase(
        number=event.number,
        from_gear=event.from_gear,
        to_gear=event.to_gear,
        is_powered=not pedals or float(np.median(pedals[0])) > OPEN_RATIO,
        start_ns=start_ns,
        t_s=t_s,
        speed_rad_s=engine.value[first:stop],
        slip_rad_s=on_slip[first:stop],
        on_pa=_around(columns[PRESSURES[clutch]], start_ns),
        off_pa=_around(columns[PRESSURES[3 - clutch]], start_ns),
        drive=np.array([[0.0, 1.0]]) if source is None else _around(source, start_ns),
    )


def _input_speeds(event: Event, t_ns: Int64Array, gears: GearRatios | None) -> tuple[FloatArray, FloatArray] | None:
    """Return the speeds behind the on-coming and the off-going clutch at some times."""
    columns, clutches = event.columns, (clutch_of_gear(event.to_gear), clutch_of_gear(event.from_gear))
    shafts = [columns.get(INPUTS[clutch], NO_SAMPLES) for clutch in clutches]
    if gears is not None and max(event.from_gear, event.to_gear) <= len(gears.ratios):
        over = columns.get(gears.over, NO_SAMPLES)
        if len(over.t_ns):
            speed = np.interp(t_ns, over.t_ns, over.value)
            return gears.ratios[event.to_gear - 1] * speed, gears.ratios[event.from_gear - 1] * speed
    if clutches[0] != clutches[1] and all(len(series.t_ns) for series in shafts):
        return np.interp(t_ns, shafts[0].t_ns, shafts[0].value), np.interp(t_ns, shafts[1].t_ns, shafts[1].value)
    return None


class Standing:
    """The pressure of a clutch in gear while the car stands: where it begins to carry."""

    def __init__(self, most: int | None = None) -> None:
        self._pressures_pa = deque[FloatArray](maxlen=most)  # of the last batches in which the car stood

    def add(self, batch: ColumnBatch | Event) -> None:
        """Take up the pressures of one batch."""
        output, pressure = (batch.columns.get(signal) for signal in (Signal.OUTPUT_SPEED, PRESSURES[1]))
        if output is None or pressure is None or not len(output.t_ns):
            return
        is_standing = np.interp(pressure.t_ns, output.t_ns, output.value) < STANDING_RAD_S
        if (held := is_standing & (pressure.value > HELD_PA)).any():
            self._pressures_pa.append(pressure.value[held])

    @property
    def touch_pa(self) -> float | None:
        """The middle of them; None if the car never stood."""
        pressures_pa = np.concatenate([np.empty(0), *self._pressures_pa])
        return float(np.median(pressures_pa)) if len(pressures_pa) else None


def _around(series: Series, start_ns: int) -> FloatArray:
    return np.column_stack([(series.t_ns - start_ns) / NS_PER_S, series.value])


# --- the model --------------------------------------------------------------------------------------------------------
