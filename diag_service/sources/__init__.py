"""Where frames come from: live buses and log files, all as FrameBatch."""

from diag_service.sources.base import FrameSource, SourceCounts
from diag_service.sources.factory import open_source
from diag_service.sources.logs import LogFormat, LogReader, is_log, read_log
from diag_service.sources.tally import LogCounts, LogReject

__all__ = [
    "FrameSource",
    "LogCounts",
    "LogFormat",
    "LogReader",
    "LogReject",
    "SourceCounts",
    "is_log",
    "open_source",
    "read_log",
]
