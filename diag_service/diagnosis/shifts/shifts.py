"""Shift detection: canonical columns in, shift events out."""

from diag_service.diagnosis.shifts.gear_tracking import GearPairTracker
from diag_service.diagnosis.shifts.tracking import NS_PER_S, EventFinder, Tracker

PRE_NS = NS_PER_S // 2  # history before the shift: the on-coming clutch empty, the off-going one locked
POST_NS = NS_PER_S // 10  # after it: what sensor latencies and the crank segment reach back from


class ShiftFinder(EventFinder):
    """Finds shifts; without a tracker as current and target gear tell."""

    def __init__(self, tracker: Tracker | None = None) -> None:
        super().__init__(tracker or GearPairTracker(), PRE_NS, POST_NS)
