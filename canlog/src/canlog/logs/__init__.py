"""Logs of every format; damage is counted and passed over."""

from canlog.frames import merged_by_time
from canlog.logs.detection import LogFormat
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.reading import LogReader, Looked, looked_at, read_log, table_columns
from canlog.logs.streams import STANDARD_INPUT, shown_name

__all__ = [
    "STANDARD_INPUT",
    "LogCounts",
    "LogFormat",
    "LogReader",
    "LogReject",
    "Looked",
    "looked_at",
    "merged_by_time",
    "read_log",
    "shown_name",
    "table_columns",
]
