"""Logs of every format, read whatever is damaged and counted."""

from canlog.logs.archives import split_member
from canlog.logs.detection import LogFormat
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.merging import merged_by_time
from canlog.logs.reading import LogReader, Looked, is_folder, is_log, looked_at, read_log, table_columns, why_no_log
from canlog.logs.streams import STANDARD_INPUT, shown_name

__all__ = [
    "STANDARD_INPUT",
    "LogCounts",
    "LogFormat",
    "LogReader",
    "LogReject",
    "Looked",
    "is_folder",
    "is_log",
    "looked_at",
    "merged_by_time",
    "read_log",
    "shown_name",
    "split_member",
    "table_columns",
    "why_no_log",
]
