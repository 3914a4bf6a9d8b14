"""Results as rows, and as what libraries call a table."""

import polars as pl
import pyarrow as pa
import pytest

from diag_service.api.analysis import ResultTable

TYPES = {"seq": "int64", "friction.mu_c": "float64", "reasons": "string", "complete": "bool"}
ROWS = [
    {"seq": 1, "friction.mu_c": 0.12, "reasons": "", "complete": True, "not a column": 1},
    {"seq": 2, "reasons": "interrupted;<b>", "complete": True},
]


def test_it_is_a_sequence_of_rows() -> None:
    table = ResultTable(TYPES, ROWS)
    assert len(table) == 2
    assert table[1] == {"seq": 2, "friction.mu_c": None, "reasons": "interrupted;<b>", "complete": True}
    assert [row["seq"] for row in table] == [1, 2]
    assert table.column("friction.mu_c") == [0.12, None]
    assert table.columns == tuple(TYPES)
    with pytest.raises(KeyError, match="mu_s"):
        table.column("mu_s")
    assert repr(table) == "<2 rows of 4 columns: seq, friction.mu_c, reasons, complete>"


def test_libraries_take_it_with_its_types() -> None:
    table = ResultTable(TYPES, ROWS)
    assert table.to_arrow().to_pylist() == list(table)
    assert pa.table(table).schema.types == [pa.int64(), pa.float64(), pa.string(), pa.bool_()]
    assert table.to_pandas()["seq"].tolist() == [1, 2]
    assert pl.DataFrame(table).to_dicts() == table.to_polars().to_dicts() == list(table)
    assert ResultTable(TYPES, []).to_arrow().schema == table.to_arrow().schema
