"""Detection of gear changes and of what slips without one: canonical columns in, events out."""

from collections.abc import Set as AbstractSet

from clutch_model.calibration import Calibration
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.shifts.event_tracking import EventTracker, SideBySide
from diag_service.diagnosis.shifts.gear_tracking import GearPairTracker, LaunchTracker, tracker_for
from diag_service.diagnosis.shifts.slip_tracking import SlipTracker, slip_signals
from diag_service.diagnosis.shifts.tracking import NS_PER_S, EventFinder, Tracker

PRE_NS = NS_PER_S // 2  # history before the event: the on-coming clutch empty, the off-going one locked
REST_NS = 11 * NS_PER_S // 5  # before a launch: two seconds of the engine at idle, both clutches open
POST_NS = NS_PER_S // 10  # after it: what sensor latencies and the crank segment reach back from


class ShiftFinder(EventFinder):
    """Finds shifts; without a tracker as current and target gear tell."""

    def __init__(self, tracker: Tracker | None = None) -> None:
        super().__init__(tracker or GearPairTracker(), PRE_NS, POST_NS)


class DriveFinder(EventFinder):
    """Finds all events of a drive that the signals of a bus can tell, each with its kind.

    Parameters
    ----------
    signals, gears
        What the bus can deliver; where it tells neither slip nor load, gear changes alone are found.
    calibration
        Touch points of the clutches.
    """

    def __init__(self, signals: AbstractSet[Signal], calibration: Calibration, gears: GearRatios | None = None) -> None:
        slip = slip_signals(signals, calibration)
        tracker: Tracker = EventTracker(tracker_for(signals, gears), None if slip is None else SlipTracker(slip))
        if slip is None and gears is not None and signals >= {Signal.ENGINE_SPEED, gears.over}:
            told = next((one for one in (Signal.CURRENT_GEAR, Signal.TARGET_GEAR) if one in signals), None)
            tracker = SideBySide(tracker, LaunchTracker(gears, told))
        super().__init__(tracker, PRE_NS, POST_NS, REST_NS)
