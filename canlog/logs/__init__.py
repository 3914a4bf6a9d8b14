"""Logs of every format, read whatever is damaged and counted."""

from canlog.logs.detection import LogFormat
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.merging import merged_by_time
from canlog.logs.piped import STANDARD_INPUT, shown_name
from canlog.logs.reading import LogReader, is_log, read_log, why_no_log

__all__ = [
    "STANDARD_INPUT",
    "LogCounts",
    "LogFormat",
    "LogReader",
    "LogReject",
    "is_log",
    "merged_by_time",
    "read_log",
    "shown_name",
    "why_no_log",
]
