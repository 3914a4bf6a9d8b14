"""Text logs of separated columns in any order, as their header names them or as one says oneself."""

from canlog.logs.columns.log import NO_HEADER, ColumnsLog, columns_seen, is_list

__all__ = ["NO_HEADER", "ColumnsLog", "columns_seen", "is_list"]
