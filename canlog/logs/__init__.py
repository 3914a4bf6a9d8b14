"""Logs of every format, read whatever is damaged and counted."""

from canlog.logs.detection import LogFormat
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.merging import merged_by_time
from canlog.logs.reading import LogReader, is_log, read_log, why_no_log

__all__ = [
    "LogCounts",
    "LogFormat",
    "LogReader",
    "LogReject",
    "is_log",
    "merged_by_time",
    "read_log",
    "why_no_log",
]
