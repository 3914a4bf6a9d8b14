"""Text logs of separated columns in any order, as their header names them or as one says oneself."""

from canlog.logs.columns.header import guessed, is_list, is_traffic
from canlog.logs.columns.log import NO_HEADER, ColumnsLog, columns_seen, proposed

__all__ = ["NO_HEADER", "ColumnsLog", "columns_seen", "guessed", "is_list", "is_traffic", "proposed"]
