"""Decoded frames as Parquet, a file for each message."""

from canlog.parquet.codes import Packer
from canlog.parquet.column_file import ColumnFile
from canlog.tables.account import DecodeAccount
from canlog.tables.frame_stock import FrameGroup
from canlog.tables.inputs import Origins
from canlog.tables.layouts import Values
from canlog.tables.parquet_tables import WideParquet
from canlog.tables.sinks import message_layout
from canlog.tables.table_folder import TableFolder


class MessageParquet:
    """A table for each message, of its frames alone: nothing in it is null but pages of a multiplexer."""

    def __init__(self, tables: TableFolder, account: DecodeAccount, values: Values, origins: Origins | None) -> None:
        self._tables = tables
        self._account = account
        self._values = values
        self._origins = origins
        self._packer = Packer()  # its room is as large as a group: one serves all
        self._open: dict[int, WideParquet] = {}

    def write_group(self, group: FrameGroup) -> None:
        """Write some frames, message by message."""
        for slot, own in group.by_message():
            self._table(slot).write_group(own)

    def close(self) -> None:
        """Write the ends of the files."""
        for table in self._open.values():
            table.close()

    def discard(self) -> None:
        """Leave them as they are."""

    def _table(self, slot: int) -> WideParquet:
        if slot not in self._open:
            layout = message_layout(self._account, slot, self._values, self._origins)
            file = ColumnFile(self._tables.file(slot), self._packer)
            self._open[slot] = WideParquet(file, self._account, layout, self._origins)
        return self._open[slot]
