"""What was made of which log: rows in Parquet files that are only ever added, and now and then put together.

A file of rows has a generation in its name, and of a log the row of the latest generation holds. So nothing is written
over, whoever was killed, and a log that two files tell of is in the lake once.
"""

import hashlib
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from canlog.parquet_file import TIME_TYPE, ParquetTable, load_pyarrow
from diag_service.diagnosis.records import iso_utc
from diag_service.errors import StoreError
from diag_service.lake.places import Place

FOLDER: Final = "manifest"
DONE, FAILED = "done", "failed"
_SEPARATOR: Final = ";"
_TYPES: Final = {"size_bytes": "int64", "shifts": "int64", "attempts": "int64", "made_at": TIME_TYPE}


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRow:
    """What became of one log."""

    source: str  # where it was found: by it a log is known
    key: str  # the log as it was found: place, name, size, time of change, vehicle
    size_bytes: int
    vehicle: str
    content: str  # sha256 of the log; empty if it could not be read at all
    settings: str  # digest of all that decides about shifts besides the log
    signals: str  # digest of all that decides about decoded signals; empty: none were asked for
    algorithm_version: str
    outcome: str  # done or failed
    reason: str  # why it failed, or what of it could not be read; empty if all is well
    shifts: int
    attempts: int
    parts: tuple[str, ...]  # the files that were made of it
    account: str  # what it said, as JSON
    made_at: str  # ISO 8601 UTC


class Manifest:
    """The rows of a lake, as they were when it was opened and as they became since.

    Raises StoreError if a file of it is none.
    """

    def __init__(self, place: Place) -> None:
        self._place = place
        self._rows: dict[str, LogRow] = {}
        self._files: list[str] = []
        self._generation = 0
        for name in place.held(FOLDER):
            self._files.append(name)
            self._generation = max(self._generation, _generation_of(name))
            self._rows |= {row.source: row for row in _parsed(place.read(name), name)}
        self.file_count = len(self._files)

    @property
    def rows(self) -> tuple[LogRow, ...]:
        """The rows that hold, in no order."""
        return tuple(self._rows.values())

    def row(self, source: str) -> LogRow | None:
        """Return what became of a log; None if nothing did."""
        return self._rows.get(source)

    def add(self, rows: Sequence[LogRow]) -> None:
        """Write rows as one more file; those of the same logs hold no longer."""
        if rows:
            self._rows |= {row.source: row for row in rows}
            self._write(rows)

    def put_together(self, *, without: Iterable[str] = ()) -> None:
        """Write one file in place of all that were read or written, without the rows of some logs."""
        gone = set(without)
        if len(self._files) <= 1 and not gone & self._rows.keys():
            return
        self._rows = {source: row for source, row in self._rows.items() if source not in gone}
        files = list(self._files)
        if self._rows:
            self._write(sorted(self._rows.values(), key=lambda row: (row.vehicle, row.source)))
        self._place.remove(files)
        self._files = [name for name in self._files if name not in files]

    def superseded(self, rows: Sequence[LogRow]) -> list[str]:
        """Return the parts that rows make superfluous: those of the rows that hold, unless another one has them."""
        before = [row.source for row in rows if row.source in self._rows]
        return self.parts_only_of(before, besides=[part for row in rows for part in row.parts]) if before else []

    def parts_only_of(self, sources: Iterable[str], *, besides: Iterable[str] = ()) -> list[str]:
        """Return the parts of some rows that no other row has; two logs of one content share theirs."""
        uses = Counter(part for row in self._rows.values() for part in row.parts)
        uses.update(besides)
        own = Counter(part for source in sources for part in self._rows[source].parts)
        return sorted(part for part, count in own.items() if uses[part] == count)

    def _write(self, rows: Sequence[LogRow]) -> None:
        self._generation += 1
        stream = io.BytesIO()
        with ParquetTable(stream, columns()) as table:
            table.write_rows([{**asdict(row), "parts": _SEPARATOR.join(row.parts)} for row in rows])
        content = stream.getvalue()
        name = f"{FOLDER}/{self._generation:010}-{hashlib.sha256(content).hexdigest()[:16]}.parquet"
        with TemporaryDirectory(prefix="clutchdiag-") as folder:
            path = Path(folder) / "rows"
            path.write_bytes(content)
            self._place.put(name, path)
        self._files.append(name)


def columns() -> dict[str, str]:
    """Return the columns of the manifest and their types; ``parts`` are names, separated by semicolons."""
    return {field.name: _TYPES.get(field.name, "string") for field in fields(LogRow)}


def _generation_of(name: str) -> int:
    number = name.removeprefix(f"{FOLDER}/").partition("-")[0]
    if not number.isdecimal():
        raise StoreError(f"{name} is not a file of a manifest")
    return int(number)


def _parsed(content: bytes, name: str) -> list[LogRow]:
    arrow = load_pyarrow()
    try:
        # By this thread alone: threads of Arrow that outlive a short program abort it.
        table = arrow.parquet.ParquetFile(io.BytesIO(content)).read(list(columns()), use_threads=False)
        return [
            LogRow(
                **{
                    **row,
                    "parts": tuple(filter(None, row["parts"].split(_SEPARATOR))),
                    "made_at": iso_utc(row["made_at"]),
                }
            )
            for row in table.to_pylist()
        ]
    except (arrow.ArrowException, KeyError, TypeError) as exc:
        raise StoreError(f"{name} is not a file of a manifest: {exc}") from exc
