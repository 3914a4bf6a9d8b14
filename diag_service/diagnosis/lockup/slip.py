"""What speeds alone tell of a lock-up clutch: how long it was locked or held at small slip, how it came there, swings.

Nothing says that the clutch carries: at small slip an open converter carries as well. So it is told what slip did, not
what the clutch did, and nothing of its friction.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array, Series
from clutch_model.units import NS_PER_S, rpm_from_rad_s
from clutch_results.event_kinds import Shudder
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.lockup.estimator import SwingBand, swings
from diag_service.diagnosis.lockup.slope import (
    HUNTING,
    LEAST_TURNING_RAD_S,
    LONGEST_GAP_NS,
    SETTLED_S,
    SHUDDER,
    SLIP_RAD_S,
    swing_lines,
)
from diag_service.diagnosis.lockup.state import LEAST_SAMPLES, LockupSamples
from diag_service.diagnosis.lockup.whole_drive import WholeDrive

OPENED_S: Final = 1.0  # of larger slip, before it counts as gone


@dataclass(frozen=True, slots=True, kw_only=True)
class LockupSlip:
    """What the slip of a lock-up clutch did in a drive, the turbine turning."""

    locked_s: float  # under 4 rpm, where a tooth of the speed sensor decides
    held_s: float  # under 95 rpm: more is not held by a clutch
    open_s: float
    closing_count: int  # how often slip fell below 95 rpm and stayed there for 4 s
    closing_times_s: tuple[float, ...]  # from there to 4 rpm, each time that it came so far within these 4 s
    shudder: Shudder | None  # None: rows are too slow for it, or slip never lasted
    hunting: Shudder | None  # the same of the slip control, slowly
    withheld: str = ""  # of friction: nothing is told of it that could be

    def lines(self) -> Iterator[str]:
        """Yield it for people, a sentence each."""
        low, high = (rpm_from_rad_s(bound) for bound in SLIP_RAD_S)
        locked, held, opened = (f"{time_s:.0f} s" for time_s in (self.locked_s, self.held_s, self.open_s))
        yield f"Slip under {low:.0f} rpm for {locked}, up to {high:.0f} rpm for {held}, more for {opened}."
        times_s = self.closing_times_s
        spread = ""
        if times_s:
            spread = f"; to {low:.0f} rpm in {np.median(times_s):.1f} s as a rule, {max(times_s):.1f} s at most"
        yield f"Slip went below {high:.0f} rpm and stayed there: {self.closing_count} times{spread}."
        yield from swing_lines(self.shudder, self.hunting)


def slip_lines(slip: LockupSlip | None) -> Iterator[str]:
    """Yield what the slip of a lock-up clutch did, for people."""
    if slip is not None:
        yield "Lock-up clutch, by its slip alone:"
        yield from (f"  {line}" for line in slip.lines())


class SlipSurvey:
    """Takes up the speeds of a drive, whole."""

    def __init__(self) -> None:
        self._drive = WholeDrive(frozenset(_WANTED))

    def feed(self, batch: ColumnBatch) -> None:
        """Keep the next columns."""
        self._drive.add(batch)

    def slip(self) -> LockupSlip | None:
        """Return what slip did; None if a signal never came."""
        return lockup_slip(self._drive.columns)


_WANTED: Final = (Signal.ENGINE_SPEED, Signal.TURBINE_SPEED, Signal.LOCKUP_SLIP)


def lockup_slip(columns: Mapping[Signal, Series]) -> LockupSlip | None:
    """Return what the slip of a lock-up clutch did; None where too few samples tell it."""
    speeds = _speeds(columns)
    if speeds is None:
        return None
    t_ns, engine, turbine = speeds
    size = np.abs(engine - turbine)
    step_s = np.diff(t_ns, append=t_ns[-1]) / NS_PER_S
    step_s[step_s > LONGEST_GAP_NS / NS_PER_S] = 0.0
    turns = turbine > LEAST_TURNING_RAD_S
    is_locked, is_open = size < SLIP_RAD_S[0], size > SLIP_RAD_S[1]
    closings_s = list(_closings_s(t_ns, size, turns))
    samples = LockupSamples(
        t_ns=t_ns,
        engine_rad_s=engine,
        turbine_rad_s=turbine,
        torque_nm=np.zeros(len(t_ns)),
        pressure_pa=np.where(turns & ~is_open, 1.0, 0.0),  # where slip is held, as a clutch with pressure would hold it
        oil_k=np.zeros(len(t_ns)),
        is_bridged=np.zeros(len(t_ns), np.bool_),
    )
    return LockupSlip(
        locked_s=float(step_s[turns & is_locked].sum()),
        held_s=float(step_s[turns & ~is_locked & ~is_open].sum()),
        open_s=float(step_s[turns & is_open].sum()),
        closing_count=len(closings_s),
        closing_times_s=tuple(closing_s for closing_s in closings_s if closing_s is not None),
        shudder=swings(samples, SwingBand(), 0.5) or swings(samples, SHUDDER, 0.5),  # slow rows hold 15 Hz at most
        hunting=swings(samples, HUNTING, 0.5),
    )


def _speeds(columns: Mapping[Signal, Series]) -> tuple[Int64Array, FloatArray, FloatArray] | None:
    """Return times, and speeds of engine and turbine there, at the samples of slip or turbine; None: too few."""
    engine, turbine, slip = (columns.get(signal) for signal in _WANTED)
    base = slip if turbine is None else turbine
    if base is None or engine is None or min(len(base.t_ns), len(engine.t_ns)) < LEAST_SAMPLES:
        return None
    inside = (base.t_ns >= engine.t_ns[0]) & (base.t_ns <= engine.t_ns[-1])
    t_ns, value = base.t_ns[inside], base.value[inside]
    if len(t_ns) < LEAST_SAMPLES:
        return None
    engine_rad_s = np.interp(t_ns - t_ns[0], engine.t_ns - t_ns[0], engine.value)
    return t_ns, engine_rad_s, value if turbine is not None else engine_rad_s - value


def _closings_s(t_ns: Int64Array, size_rad_s: FloatArray, turns: BoolArray) -> Iterator[float | None]:
    """Yield each time that slip fell below the larger bound and stayed there how long it took to the smaller.

    None where it is held in between.
    """
    low, high = SLIP_RAD_S
    is_open = ~turns | (size_rad_s > high)
    bounds = np.concatenate(([0], np.flatnonzero(np.diff(is_open.astype(np.int8))) + 1, [len(t_ns)])).tolist()
    for before, first, stop in zip(bounds, bounds[1:], bounds[2:], strict=False):
        was_open_s, stays_s = (t_ns[first] - t_ns[before]) / NS_PER_S, (t_ns[stop - 1] - t_ns[first]) / NS_PER_S
        if is_open[first] or was_open_s < OPENED_S or stays_s < SETTLED_S or not turns[before:first].all():
            continue
        closed = np.flatnonzero(size_rad_s[first:stop] < low)
        closing_s = float(t_ns[first + closed[0]] - t_ns[first]) / NS_PER_S if len(closed) else math.inf
        yield closing_s if closing_s <= SETTLED_S else None
