"""Text logs that are tables: one compiled reader, a layout for each format."""

from canlog.logs.tables.busmaster import Busmaster
from canlog.logs.tables.crtd import Crtd
from canlog.logs.tables.csv_tables import GvretCsv, PythonCanCsv
from canlog.logs.tables.table import Table
from canlog.logs.tables.trc import Trc

__all__ = ["Busmaster", "Crtd", "GvretCsv", "PythonCanCsv", "Table", "Trc"]
