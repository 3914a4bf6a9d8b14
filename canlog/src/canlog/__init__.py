"""CAN logs, live buses and message databases: bytes or sockets to frames, frames to protected, decoded columns.

    log = canlog.read("drive.blf", "car.dbc")
    frame = log.to_pandas("wide")

What is named here is imported when it is first used: ``import canlog`` itself takes no time and compiles nothing.
"""

import typing

from canlog.extras import on_demand as _on_demand
from canlog.extras import wait_with as _wait_with

if typing.TYPE_CHECKING:
    from canlog.database.loading import load_database
    from canlog.errors import CanlogError, DefinitionError, ExtraMissingError, OutputError, SourceError
    from canlog.frames import FrameBatch
    from canlog.logs import LogCounts, LogFormat, LogReader, read_log
    from canlog.tables.decoding import TableChoice, write_table
    from canlog.whole_log import Log, Samples, read

__all__ = [
    "CanlogError",
    "DefinitionError",
    "ExtraMissingError",
    "FrameBatch",
    "Log",
    "LogCounts",
    "LogFormat",
    "LogReader",
    "OutputError",
    "Samples",
    "SourceError",
    "TableChoice",
    "load_database",
    "read",
    "read_log",
    "write_table",
]

_wait_with("cantools.tester")  # a live bus for cantools; it takes python-can along, and that asammdf, pandas and polars
__getattr__, __dir__ = _on_demand(__name__, __file__)
