"""What takes decoded frames: one table of rows, or one for each message, in the formats that take whole columns."""

from itertools import groupby
from typing import BinaryIO, Protocol

from canlog.tables.account import DecodeAccount
from canlog.tables.frame_stock import FrameGroup
from canlog.tables.groups import columns_of, values_in
from canlog.tables.inputs import Origins
from canlog.tables.layouts import LongLayout, Values, WideLayout, frame_kinds
from canlog.tables.outputs import ColumnSink, TableFormat, open_columns
from canlog.tables.table_folder import TableFolder


class TableSink(Protocol):
    """What takes groups of frames."""

    def write_group(self, group: FrameGroup) -> None:
        """Write some frames; values and rows enter the account."""

    def close(self) -> None:
        """Write what the format needs at its end."""

    def discard(self) -> None:
        """Leave what there is: it is not complete."""


class ColumnRows:
    """Rows of columns into any file of columns."""

    def __init__(
        self, output: BinaryIO, table_format: TableFormat, layout: WideLayout | LongLayout, account: DecodeAccount
    ) -> None:
        self._layout = layout
        self._account = account
        self._columns = open_columns(output, table_format, layout.kinds, layout.metadata)

    def write_group(self, group: FrameGroup) -> None:
        if columns := columns_of(group, self._account, self._layout):
            self._columns.write_columns(columns)

    def close(self) -> None:
        """Write the end."""
        self._columns.close()

    def discard(self) -> None:
        """Leave it as it is."""
        self._columns.discard()


class MessageRows:
    """A table for each message, of its frames alone."""

    def __init__(
        self,
        tables: TableFolder,
        table_format: TableFormat,
        account: DecodeAccount,
        values: Values,
        origins: Origins | None,
    ) -> None:
        self._tables = tables
        self._format = table_format
        self._account = account
        self._values = values
        self._origins = origins
        self._open: dict[int, tuple[WideLayout, ColumnSink]] = {}

    def write_group(self, group: FrameGroup) -> None:
        """Write some frames, message by message."""
        found = sorted(values_in(group, self._account), key=lambda one: one.slot)
        for slot, parts in groupby(found, key=lambda one: one.slot):
            layout, sink = self._table(slot)
            count, columns = layout.columns(group, list(parts))
            self._account.row_count += count
            sink.write_columns(columns)

    def close(self) -> None:
        """Write the ends."""
        for _, sink in self._open.values():
            sink.close()

    def discard(self) -> None:
        """Leave them as they are."""
        for _, sink in self._open.values():
            sink.discard()

    def _table(self, slot: int) -> tuple[WideLayout, ColumnSink]:
        if slot not in self._open:
            layout = message_layout(self._account, slot, self._values, self._origins)
            sink = open_columns(self._tables.file(slot), self._format, layout.kinds, layout.metadata)
            self._open[slot] = layout, sink
        return self._open[slot]


def message_layout(
    account: DecodeAccount, slot: int, values: Values, origins: Origins | None, *, is_measured: bool = False
) -> WideLayout:
    """Return the columns of the table of one message, called as its signals are."""
    names = account.names.of_message(slot, frame_kinds(origins))
    return WideLayout(account.codec.tables, names, values, [slot], origins, is_measured=is_measured)
