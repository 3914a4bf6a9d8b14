"""Results as tables: the columns are the schema's, and a file appears whole or not at all."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from diag_service.batch.journal import Entry
from diag_service.batch.tables import columns, flattened, write_results
from diag_service.diagnosis.records import shift_record
from diag_service.errors import StoreError
from tests.support.builders import rejected, shift_result

ENTRIES = tuple(
    Entry(key=str(seq), drive={"paths": [f"{seq}.log"]}, shifts=(shift_record(result),))
    for seq, result in enumerate((shift_result(1), rejected(shift_result(2))))
)


def test_a_row_has_columns_of_the_schema_only() -> None:
    row = {"path": "a.log", **flattened(shift_record(shift_result()))}
    assert row.keys() - {"indices", "verdict.lining", "verdict.stick_slip"} <= columns().keys()  # null as a whole
    assert columns()["friction.mu_c"] == "float64"
    assert columns()["clutch"] == columns()["tier"] == columns()["seq"] == "int64"
    assert columns()["reasons"] == columns()["status"] == "string"


@pytest.mark.parametrize("name", ["out.jsonl", "out.csv", "out.parquet"])
def test_a_file_that_cannot_be_completed_does_not_appear(tmp_path: Path, name: str) -> None:
    def broken() -> Iterator[Entry]:
        yield ENTRIES[0]
        raise OSError(28, "No space left on device")

    (tmp_path / name).write_bytes(b"before")
    with pytest.raises(StoreError, match="No space left"):
        write_results(tmp_path / name, broken())
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"before"
