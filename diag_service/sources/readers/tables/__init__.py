"""Text logs that are tables: one compiled reader, a layout for each format."""

from diag_service.sources.readers.tables.busmaster import Busmaster
from diag_service.sources.readers.tables.crtd import Crtd
from diag_service.sources.readers.tables.csv_tables import GvretCsv, PythonCanCsv
from diag_service.sources.readers.tables.reader import Table, TableReader, frames_in, frames_of, reader_of
from diag_service.sources.readers.tables.trc import Trc

__all__ = [
    "Busmaster",
    "Crtd",
    "GvretCsv",
    "PythonCanCsv",
    "Table",
    "TableReader",
    "Trc",
    "frames_in",
    "frames_of",
    "reader_of",
]
