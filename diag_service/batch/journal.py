"""The journal of a run over folders: one line per drive that is done, on disk before the next one counts.

Whoever starts again finds in it what is done; a line that was cut off by a kill is dropped.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from clutch_results.records import dump
from clutchdiag_io.files import OPEN_FLAGS, PRIVATE_MODE, keep_private, lock
from diag_service.errors import StoreError
from fleet_contract import JsonObject

JOURNAL_SCHEMA = "clutchdiag/journal/v1"


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
        done: dict[str, int] = {}
        end = 0
        for start, line in self._lines():
            try:
                table = json.loads(line)
            except ValueError:
                break
            if not isinstance(table, dict) or table.get("schema") != JOURNAL_SCHEMA:
                raise StoreError(f"{self.path} is not a journal of diag-service")
            end = start + len(line)
            if table["settings"] == self._settings:
                done[table["key"]] = start
        begin = b'{"schema":"' + JOURNAL_SCHEMA.encode()
        with self.path.open("rb") as file:
            is_ours = begin.startswith(file.read(len(begin)))  # the first line, cut off
        if end == 0 and not is_ours:
            raise StoreError(f"{self.path} is not a journal of diag-service")
        os.ftruncate(self._descriptor, end)
        return done

    def _lines(self) -> Iterator[tuple[int, bytes]]:
        start = 0
        with self.path.open("rb") as file:
            for line in file:
                if not line.endswith(b"\n"):
                    return
                yield start, line
                start += len(line)
