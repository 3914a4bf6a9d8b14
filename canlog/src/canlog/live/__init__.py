"""Live buses: received without waiting, supervised, in bus time."""

from canlog.live.opening import BusOpener
from canlog.live.sources import BusSilence, FrameSource, LinkBreak, LiveSource, ReadSchedule, SourceCounts
from canlog.live.supervisor import BusState, BusStatus, SupervisedSource, supervise

__all__ = [
    "BusOpener",
    "BusSilence",
    "BusState",
    "BusStatus",
    "FrameSource",
    "LinkBreak",
    "LiveSource",
    "ReadSchedule",
    "SourceCounts",
    "SupervisedSource",
    "supervise",
]
