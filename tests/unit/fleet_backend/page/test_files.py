"""Answers as files: every digit, no formula, and a Parquet that reads back the same."""

import csv
import io
import json
from datetime import UTC, datetime

from pyarrow import parquet

from fleet_backend.page.files import Format, csv_of, file_of, json_of
from fleet_backend.page.records import Change, ClutchNow
from tests.support.fleet_page import clutch_now

DIGITS = 0.1 + 0.2
ROWS = [clutch_now("a", mu_c=DIGITS, fluid="=1+1", condition_reason='ä, "b"\nc'), clutch_now("b", mu_c=None, fluid="-")]


def test_csv_has_all_digits_and_no_formula() -> None:
    first, second = csv.DictReader(io.StringIO(csv_of(ROWS, ClutchNow).decode(), newline=""))
    assert float(first["mu_c"]) == DIGITS
    assert (first["fluid"], second["fluid"], second["mu_c"]) == ("'=1+1", "'-", "")
    assert first["condition_reason"] == 'ä, "b"\nc'
    assert first["end_at"] == "2026-03-01T12:00:00Z"


def test_parquet_reads_back_the_same() -> None:
    (first, second) = parquet.read_table(io.BytesIO(file_of(Format.PARQUET, ROWS, ClutchNow))).to_pylist()
    assert (first["mu_c"], second["mu_c"], first["fluid"]) == (DIGITS, None, "=1+1")
    assert first["end_at"] == datetime(2026, 3, 1, 12, tzinfo=UTC)


def test_several_reasons_are_one_cell() -> None:
    change = Change(
        vehicle="a", clutch=1, condition_before=None, condition="good", mu_c_before=None, std_mu_c_before=None,
        mu_c=DIGITS, std_mu_c=None, new_result_count=2, why=("new data: 2 results", "new fluid: x"),
    )  # fmt: skip
    (row,) = csv.DictReader(io.StringIO(csv_of([change], Change).decode(), newline=""))
    assert row["why"] == "new data: 2 results;new fluid: x"
    assert json.loads(json_of(change))["why"] == ["new data: 2 results", "new fluid: x"]
