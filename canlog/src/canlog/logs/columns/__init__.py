"""Text logs of separated columns in any order, named by their header or by ``--columns``."""

from canlog.logs.columns.log import NO_HEADER, ColumnsLog, header_names, is_list

__all__ = ["NO_HEADER", "ColumnsLog", "header_names", "is_list"]
