"""Tables of signals, a row for each moment and a column for each signal: how they are written, stage by stage."""

from canlog.logs.signal_tables.cells import LEAST_ROWS
from canlog.logs.signal_tables.header import signal_columns
from canlog.logs.signal_tables.reading import all_columns, checked_rows, frames_of_rows, read_signal_table
from canlog.logs.signal_tables.table import NoTable, TableHeader, table_header, table_of

__all__ = [
    "LEAST_ROWS",
    "NoTable",
    "TableHeader",
    "all_columns",
    "checked_rows",
    "frames_of_rows",
    "read_signal_table",
    "signal_columns",
    "table_header",
    "table_of",
]
