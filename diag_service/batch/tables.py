"""Results of many drives: a journal, a line per drive that is done; and one file of all: JSON lines, CSV, Parquet."""

import csv
import errno
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Self

from canlog.column_files import BOOL_TYPE, TIME_TYPE, ParquetTable, load_pyarrow
from canlog.files import is_folder, replacing
from clutch_results.records import REVISIONS, dump
from clutchdiag_io.files import OPEN_FLAGS, PRIVATE_MODE, keep_private, lock
from clutchdiag_io.program import legible
from diag_service.errors import ConfigError, StoreError
from fleet_contract import Channel, JsonObject, schema

JOURNAL_SCHEMA = "clutchdiag/journal/v1"
_BEGIN = b'{"schema":"' + JOURNAL_SCHEMA.encode()  # of each line


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One drive that is done: its account, or why it could not be read, and its shifts."""

    key: str
    drive: JsonObject
    shifts: tuple[JsonObject, ...]

    @property
    def is_complete(self) -> bool:
        """Whether the whole drive was read."""
        summary = self.drive.get("summary")
        return isinstance(summary, dict) and bool(summary["complete"])


class Journal:
    """A file of JSON lines, owned by one process at a time; created where there is none.

    ``settings`` is a digest of all that decides about results: entries of other settings are not taken for done.
    Raises StoreError if the file cannot be read or written, is another program's, or is in use.
    """

    def __init__(self, path: Path, settings: str) -> None:
        self.path = path
        self._settings = settings
        with self._translated("use"):
            self._descriptor = os.open(path, OPEN_FLAGS, PRIVATE_MODE)
            try:
                lock(self._descriptor)
                self.done = self._recover()
                keep_private(path)
            except BaseException:
                os.close(self._descriptor)
                raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)

    def add(self, entry: Entry) -> None:
        """Write a drive that is done, to the disk; raises StoreError if the disk does not take it."""
        record: JsonObject = {
            "schema": JOURNAL_SCHEMA,
            "settings": self._settings,
            "key": entry.key,
            "drive": entry.drive,
            "shifts": list(entry.shifts),
        }
        line = (dump(record) + "\n").encode()
        with self._translated("write"):
            end = os.lseek(self._descriptor, 0, os.SEEK_END)
            if os.write(self._descriptor, line) != len(line):
                os.ftruncate(self._descriptor, end)
                raise StoreError(f"cannot write {self.path}: the disk is full")
            os.fsync(self._descriptor)
        self.done[entry.key] = end

    def entry(self, key: str) -> Entry:
        with self.path.open("rb") as file:
            file.seek(self.done[key])
            table = json.loads(file.readline())
        return Entry(key=key, drive=table["drive"], shifts=tuple(table["shifts"]))

    @contextmanager
    def _translated(self, verb: str) -> Iterator[None]:
        try:
            yield
        except BlockingIOError as exc:
            raise StoreError(f"{self.path} is in use by another run") from exc
        except OSError as exc:
            raise StoreError(f"cannot {verb} {self.path}: {exc.strerror}") from exc

    def _recover(self) -> dict[str, int]:
        """Return where each finished drive stands, and cut off what a kill left behind it."""
        done, end = dict[str, int](), 0
        with self.path.open("rb") as file:
            for line in file:
                is_ours = line.startswith(_BEGIN)
                if not end and not is_ours and not _BEGIN.startswith(line):  # nor a first line that was cut off
                    raise StoreError(f"{self.path} is not a journal of diag-service")
                try:
                    table = json.loads(line) if is_ours and line.endswith(b"\n") else None
                except ValueError:
                    break
                if table is None:
                    break
                if table["settings"] == self._settings:
                    done[table["key"]] = end
                end += len(line)
        os.ftruncate(self._descriptor, end)
        return done


BATCH_ROWS = 4096
MOMENT = "moment"
TYPES = {"integer": "int64", "number": "float64", MOMENT: TIME_TYPE}


def check_output(path: Path) -> None:
    """Find out before hours of work whether results can be written as this file.

    Raises ConfigError if the name asks for no format, ExtraMissingError if pyarrow is missing for it, StoreError if
    there is no such folder.
    """
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        raise ConfigError(f"{path}: results are written as {', '.join(_WRITERS)}")
    if suffix == PARQUET:
        load_pyarrow()
    if not is_folder(path.parent):
        raise StoreError(f"cannot write {path}: {os.strerror(errno.ENOENT)}")


def write_results(path: Path, entries: Iterable[Entry]) -> None:
    """Write the shifts of all drives, and in JSON lines their accounts; replaces the file when it is complete.

    Raises StoreError if the file cannot be written, ExtraMissingError if Parquet is asked for and pyarrow is missing.
    """
    with replacing(path, StoreError) as part:
        _WRITERS[path.suffix.lower()](part, entries)
        part.replace(path)


def write_parquet(path: Path, rows: Iterable[Mapping[str, object]]) -> None:
    """Write rows with the ``columns`` of the table, some at a time."""
    remaining = iter(rows)
    with path.open("wb") as stream, ParquetTable(stream, columns()) as table:
        while group := list(islice(remaining, BATCH_ROWS)):
            table.write_rows(group)


def columns() -> dict[str, str]:
    """Return the columns of the table and their types, from the schema of a shift result: nested keys by dots."""
    return {"path": "string", "complete": BOOL_TYPE, **record_columns(Channel.SHIFT)}


def record_columns(channel: Channel) -> dict[str, str]:
    """Return the columns that the records of a channel have as rows, and their types, from its schema."""
    description = schema(channel.label)
    return {name: kind for name, kind in _leaves(description, description) if name != REVISIONS}


def drive_rows(
    paths: Iterable[object], shifts: Iterable[JsonObject], *, is_complete: bool
) -> Iterator[dict[str, object]]:
    """Yield the rows of one drive, a shift each, with the ``columns`` of the table."""
    path = legible(";".join(map(str, paths)))
    for shift in shifts:
        yield {"path": path, "complete": is_complete, **flattened(shift)}


def flattened(record: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Return a record without nesting: keys joined by dots, lists by semicolons; what it revised is in other rows."""
    flat: dict[str, object] = {}
    for key, value in record.items():
        if key == REVISIONS:
            continue
        if isinstance(value, Mapping):
            flat |= flattened(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = ";".join(map(str, value)) if isinstance(value, list | tuple) else value
    return flat


def _leaves(table: Mapping[str, object], root: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    properties = table["properties"]
    definitions = root["$defs"]
    if not isinstance(properties, dict) or not isinstance(definitions, dict):
        raise TypeError("not the schema of a result")
    for key, description in properties.items():
        if reference := description.get("$ref"):
            yield from _leaves(definitions[reference.rsplit("/", 1)[-1]], root, f"{prefix}{key}.")
            continue
        if "properties" in description:
            yield from _leaves(description, root, f"{prefix}{key}.")
            continue
        names = description.get("propertyNames", {}).get("enum", [])
        if names:
            yield from ((f"{prefix}{key}.{name}", "float64") for name in names)
            continue
        kinds = description.get("type")
        kind = kinds[0] if isinstance(kinds, list) else kinds
        if description.get("format") == "date-time":
            kind = MOMENT
        if kind is None and all(isinstance(choice, int) for choice in description.get("enum", [""])):
            kind = "integer"
        yield f"{prefix}{key}", TYPES.get(str(kind), "string")


def _rows(entries: Iterable[Entry]) -> Iterator[dict[str, object]]:
    for entry in entries:
        paths = entry.drive["paths"]
        names = paths if isinstance(paths, list) else [paths]
        yield from drive_rows(names, entry.shifts, is_complete=entry.is_complete)


def _write_json_lines(part: Path, entries: Iterable[Entry]) -> None:
    with part.open("w", encoding="utf-8", errors="backslashreplace") as file:
        for entry in entries:
            records: list[JsonObject] = [*entry.shifts, entry.drive]
            file.writelines(dump(record) + "\n" for record in records)


def _write_csv(part: Path, entries: Iterable[Entry]) -> None:
    with part.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        writer = csv.DictWriter(file, list(columns()), restval="", extrasaction="ignore")
        writer.writeheader()
        writer.writerows({**row, "complete": str(row["complete"]).lower()} for row in _rows(entries))


PARQUET = ".parquet"
_WRITERS: Mapping[str, Callable[[Path, Iterable[Entry]], None]] = {
    ".jsonl": _write_json_lines,
    ".csv": _write_csv,
    PARQUET: lambda part, entries: write_parquet(part, _rows(entries)),
}
