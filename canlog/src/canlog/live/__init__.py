"""Live buses: received without waiting, supervised, in bus time."""

from canlog.live.opening import BusOpener
from canlog.live.sources import FrameSource, LinkBreak, LiveSource, ReadSchedule, Silence, SourceCounts
from canlog.live.supervisor import BusState, BusStatus, SupervisedSource, supervise

__all__ = [
    "BusOpener",
    "BusState",
    "BusStatus",
    "FrameSource",
    "LinkBreak",
    "LiveSource",
    "ReadSchedule",
    "Silence",
    "SourceCounts",
    "SupervisedSource",
    "supervise",
]
