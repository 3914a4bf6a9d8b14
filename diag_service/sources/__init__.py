"""Where frames come from: live buses and log files, all as FrameBatch."""

from diag_service.sources.base import FrameSource, LinkBreak, LiveSource, SourceCounts
from diag_service.sources.bus_state import BusState, BusStatus
from diag_service.sources.detection import LogFormat
from diag_service.sources.factory import BusOpener, open_source
from diag_service.sources.logs import LogReader, is_log, read_log
from diag_service.sources.merging import merged_by_time
from diag_service.sources.pace import Pace
from diag_service.sources.supervisor import SupervisedSource, supervise
from diag_service.sources.tally import LogCounts, LogReject

__all__ = [
    "BusOpener",
    "BusState",
    "BusStatus",
    "FrameSource",
    "LinkBreak",
    "LiveSource",
    "LogCounts",
    "LogFormat",
    "LogReader",
    "LogReject",
    "Pace",
    "SourceCounts",
    "SupervisedSource",
    "is_log",
    "merged_by_time",
    "open_source",
    "read_log",
    "supervise",
]
