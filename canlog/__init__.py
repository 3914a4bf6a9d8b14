"""CAN logs, live buses and message databases: bytes or sockets to frames, frames to protected, decoded columns.

    log = canlog.read("drive.blf", "car.dbc")
    frame = log.to_pandas()

What is named here is imported when it is first used: ``import canlog`` itself takes no time and compiles nothing.
"""

import importlib
import typing

if typing.TYPE_CHECKING:
    from canlog.database.loading import load_database
    from canlog.errors import CanlogError, DefinitionError, ExtraMissingError, OutputError, SourceError
    from canlog.frames import FrameBatch
    from canlog.logs import LogCounts, LogFormat, LogReader, read_log
    from canlog.whole_log import Log, Samples, read, write_parquet

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
    "load_database",
    "read",
    "read_log",
    "write_parquet",
]

_HOMES = {
    "canlog.database.loading": ("load_database",),
    "canlog.errors": ("CanlogError", "DefinitionError", "ExtraMissingError", "OutputError", "SourceError"),
    "canlog.frames": ("FrameBatch",),
    "canlog.logs": ("LogCounts", "LogFormat", "LogReader", "read_log"),
    "canlog.whole_log": ("Log", "Samples", "read", "write_parquet"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
