"""Where frames come from: live buses and log files, all as FrameBatch."""

from diag_service.sources.live.base import FrameSource, LinkBreak, LiveSource, SourceCounts
from diag_service.sources.live.bus_state import BusState, BusStatus
from diag_service.sources.live.factory import BusOpener, open_source
from diag_service.sources.live.pace import Pace
from diag_service.sources.live.supervisor import SupervisedSource, supervise
from diag_service.sources.readers.detection import LogFormat
from diag_service.sources.readers.logs import LogReader, is_log, read_log, why_no_log
from diag_service.sources.readers.merging import merged_by_time
from diag_service.sources.readers.tally import LogCounts, LogReject

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
    "why_no_log",
]
