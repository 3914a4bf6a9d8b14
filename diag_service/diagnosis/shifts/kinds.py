"""Kinds of gear changes: up or down, under power or not, from torque and pedal as they were when the change began."""

from typing import Final

import numpy as np

from diag_service.diagnosis.columns import EngineState, Signal
from diag_service.diagnosis.events import EventKind
from diag_service.diagnosis.shifts.history import History
from diag_service.diagnosis.shifts.slip_tracking import PEDAL_RATIO
from diag_service.diagnosis.shifts.tracking import NS_PER_S, Bounds

PULLING_NM: Final = 8.0  # engine torque from which it drives the car: what friction and auxiliaries may hide
DRIVING_RATIO: Final = 0.06  # of the pedal: beyond it a foot asks for force, below it the engine may brake
KICKDOWN_RATIO: Final = 0.5  # of the pedal
RECENT_NS: Final = NS_PER_S // 10  # before the change: torque is its mean, pedal its movement over so long
_SKIPPED: Final = 2  # gears down at once


def kind_of_change(history: History, bounds: Bounds) -> EventKind:
    """Return the kind of a change of gears; a plain shift where neither torque nor pedal is known."""
    pedal_ratio = _latest(history, Signal.PEDAL, bounds.start_ns)
    torque_nm = _torque_nm(history, bounds.start_ns)
    if pedal_ratio is None and torque_nm is None:
        return EventKind.SHIFT
    is_asked = _is_asked(pedal_ratio, torque_nm, is_lifting=_is_lifting(history, bounds.start_ns))
    if bounds.to_gear > bounds.from_gear:
        is_pulling = is_asked and (torque_nm is None or torque_nm > PULLING_NM)
        return EventKind.POWER_ON_UPSHIFT if is_pulling else EventKind.POWER_OFF_UPSHIFT
    if bounds.from_gear - bounds.to_gear >= _SKIPPED:
        return EventKind.POWER_ON_SKIP if is_asked else EventKind.COAST_SKIP
    if not is_asked:
        return EventKind.COAST_DOWNSHIFT
    is_floored = pedal_ratio is not None and pedal_ratio > KICKDOWN_RATIO
    return EventKind.KICKDOWN if is_floored else EventKind.POWER_ON_DOWNSHIFT


def _is_asked(pedal_ratio: float | None, torque_nm: float | None, *, is_lifting: bool) -> bool:
    """Return whether the driver wants the engine to drive the car, as far as pedal and torque are known."""
    is_pulling = torque_nm is not None and torque_nm > PULLING_NM
    if pedal_ratio is None:
        return is_pulling
    if pedal_ratio > DRIVING_RATIO:
        return True  # torque follows later
    return is_pulling and pedal_ratio > PEDAL_RATIO and not is_lifting  # torque outlasts the foot for a moment


def _is_lifting(history: History, start_ns: int) -> bool:
    """Return whether the foot is coming off the pedal as a change begins."""
    recent = history.samples(Signal.PEDAL, start_ns - RECENT_NS, start_ns + 1).value
    return len(recent) > 0 and bool(recent[-1] < recent[0] - PEDAL_RATIO)


def _torque_nm(history: History, start_ns: int) -> float | None:
    """Return the engine's torque just before a change; none while its fuel is cut."""
    if _latest(history, Signal.ENGINE_STATE, start_ns) == EngineState.FUEL_CUT:
        return 0.0
    recent = history.samples(Signal.ENGINE_TORQUE, start_ns - RECENT_NS, start_ns + 1).value
    return float(np.mean(recent)) if len(recent) else None


def _latest(history: History, signal: Signal, t_ns: int) -> float | None:
    """Return the value of a signal at a time, as far back as is certain to be kept."""
    recent = history.samples(signal, t_ns - NS_PER_S // 2, t_ns + 1).value
    return float(recent[-1]) if len(recent) else None
