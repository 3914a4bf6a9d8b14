"""Where frames come from: live buses and log files, all as FrameBatch."""

from diag_service.sources.base import FrameSource, SourceCounts
from diag_service.sources.factory import open_source
from diag_service.sources.logs import LogCounts, LogReader, read_log

__all__ = ["FrameSource", "LogCounts", "LogReader", "SourceCounts", "open_source", "read_log"]
