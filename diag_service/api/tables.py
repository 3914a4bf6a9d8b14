"""Results as a table: rows without any library, or what pyarrow, pandas and polars call one."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from canlog.extras import load_extra
from canlog.parquet_file import arrow_schema, row_table

Row = Mapping[str, object]
SHOWN_ROWS = 20  # in a notebook


class ResultTable:
    """Rows with named, typed columns; nested keys of a record are joined by dots, lists by semicolons.

    It is a sequence of rows, each a mapping from column to value, None where there is none. Libraries that know the
    Arrow interface take it as it is: ``pyarrow.table(table)``, ``polars.DataFrame(table)``, DuckDB.

    Attributes
    ----------
    types : Mapping of str to str
        The type of each column as Arrow names it, in the order of the columns. Names end in the SI unit of the values.
    """

    def __init__(self, types: Mapping[str, str], rows: Sequence[Row]) -> None:
        self.types = dict(types)
        self._rows = [{name: row.get(name) for name in self.types} for row in rows]

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self.types)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, number: int) -> Row:
        return self._rows[number]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows)

    def column(self, name: str) -> list[object]:
        """Return one column; raises KeyError if there is none of this name."""
        if name not in self.types:
            raise KeyError(name)
        return [row[name] for row in self._rows]

    def to_arrow(self) -> Any:  # noqa: ANN401 - an untyped library
        """Return a ``pyarrow.Table``; ExtraMissingError if pyarrow is not installed."""
        return row_table(self._rows, arrow_schema(self.types))

    def to_pandas(self) -> Any:  # noqa: ANN401 - optional
        """Return a DataFrame of pandas; ExtraMissingError if pandas or pyarrow is not installed."""
        load_extra("pandas", "to_pandas() needs pandas")
        return self.to_arrow().to_pandas()

    def to_polars(self) -> Any:  # noqa: ANN401 - optional
        """Return a DataFrame of polars; ExtraMissingError if polars or pyarrow is not installed."""
        polars = load_extra("polars", "to_polars() needs polars")
        return polars.from_arrow(self.to_arrow())

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    def __repr__(self) -> str:
        return f"<{len(self)} rows of {len(self.types)} columns: {', '.join(self.types)}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the columns that have values, the first rows."""
        names = [name for name in self.types if any(row[name] is not None for row in self._rows)]
        head = "".join(f"<th>{escape(name)}</th>" for name in names)
        rows = ("".join(f"<td>{_cell(row[name])}</td>" for name in names) for row in self._rows[:SHOWN_ROWS])
        more = len(self) - SHOWN_ROWS
        foot = f"<p>and {more} more rows</p>" if more > 0 else ""
        return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>{foot}"


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else escape(str(value))
