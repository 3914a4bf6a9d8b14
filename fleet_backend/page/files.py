"""Answers for programs: JSON, and their rows as CSV or Parquet, all digits, moments in UTC."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Final

import msgspec

from fleet_backend.errors import ExtraMissingError
from fleet_backend.page.errors import AskError

_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")  # what a spreadsheet would take for one


class Format(StrEnum):
    """How an answer is written."""

    JSON = "json"
    CSV = "csv"
    PARQUET = "parquet"


MEDIA_TYPES: Final[Mapping[Format, str]] = MappingProxyType({
    Format.JSON: "application/json",
    Format.CSV: "text/csv; charset=utf-8",
    Format.PARQUET: "application/vnd.apache.parquet",
})  # fmt: skip


def json_of(answer: object) -> bytes:
    return msgspec.json.encode(answer)


def csv_of(rows: Sequence[Any], row: type) -> bytes:
    """Return rows as CSV with a head; a text that begins like a formula gets an apostrophe before it."""
    names = [field.name for field in fields(row)]
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(names)
    writer.writerows([_csv_cell(getattr(one, name)) for name in names] for one in rows)
    return out.getvalue().encode()


def parquet_of(rows: Sequence[Any], row: type) -> bytes:
    """Return rows as Parquet; raises AskError where the server lacks the extra requirement."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError as exc:
        raise AskError(f"format: no Parquet here: {ExtraMissingError('pyarrow', extra='parquet')}") from exc
    names = [field.name for field in fields(row)]
    columns = {name: [_plain(getattr(one, name)) for one in rows] for name in names}
    out = io.BytesIO()
    parquet.write_table(pa.table(columns), out)
    return out.getvalue()


def file_of(form: Format, rows: Sequence[Any], row: type) -> bytes:
    return csv_of(rows, row) if form is Format.CSV else parquet_of(rows, row)


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return ";".join(map(str, value))
    return json.dumps(value, sort_keys=True) if isinstance(value, Mapping) else value


def _csv_cell(value: object) -> object:
    plain = _plain(value)
    if isinstance(plain, datetime):
        return plain.astimezone(UTC).isoformat().replace("+00:00", "Z")
    return f"'{plain}" if isinstance(plain, str) and plain.startswith(_FORMULA) else plain
