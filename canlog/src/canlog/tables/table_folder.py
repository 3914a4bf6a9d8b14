"""A folder of tables, one for each message, which appear together when all of them are complete."""

import io
import os
import shutil
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO, Final, cast

from canlog.column_files import SUFFIX_OF_FORMAT, TableFormat
from canlog.errors import OutputError
from canlog.files import is_plain_file, is_there
from canlog.tables.layouts import TableNames

LONGEST_BYTES: Final = 160  # of a name without number and suffix; systems take 255
_KEPT: Final = frozenset("-_+@=.")
_DEVICES: Final = frozenset(
    {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(10))}
)  # of Windows, whatever the suffix
_NAMELESS: Final = "_"


def file_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return a name of a file, without a suffix, for each name.

    Letters and digits of any script stay, what a system or a shell might take for something else becomes ``_``. Names
    that differ in nothing but case, or become alike, get a number.
    """
    safe_names: list[str] = []
    folded: set[str] = set()
    for name in names:
        safe = base = _safe(name)
        number = 1
        while safe.casefold() in folded:
            number += 1
            safe = f"{base}-{number}"
        folded.add(safe.casefold())
        safe_names.append(safe)
    return tuple(safe_names)


def _safe(name: str) -> str:
    composed = unicodedata.normalize("NFC", name)
    safe = "".join(letter if letter.isalnum() or letter in _KEPT else _NAMELESS for letter in composed)
    safe = safe.encode(errors="replace")[:LONGEST_BYTES].decode(errors="ignore").strip(".") or _NAMELESS
    return f"{_NAMELESS}{safe}" if safe.split(".")[0].casefold() in _DEVICES else safe


HELD_BYTES: Final = 65_536  # of each file, until it is opened and written to: no system lets hundreds be open at once
_NUMBERS: Final = count(1)  # threads may write the same folder at the same time
WriteBuffer = bytes | bytearray | memoryview


class BriefFile(io.RawIOBase):
    """A file that is open only while something is added to it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._held = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, content: WriteBuffer) -> int:  # type: ignore[override]  # any buffer will do
        """Take bytes; return how many that were."""
        size = memoryview(content).nbytes
        self._held += content
        if len(self._held) >= HELD_BYTES:
            self.flush()
        return size

    def flush(self) -> None:
        if self._held:
            with self._path.open("ab") as file:
                file.write(self._held)
            self._held.clear()

    def forget(self) -> None:
        """Leave what is held: the file is not wanted any more."""
        self._held.clear()


class TableFolder:
    """Where the tables of messages are written until all are complete."""

    def __init__(self, folder: Path, part: Path, names: Mapping[int, str]) -> None:
        self._folder = folder
        self._part = part
        self._names = names
        self._files: dict[int, BriefFile] = {}

    def file(self, slot: int) -> BinaryIO:
        if slot not in self._files:
            self._files[slot] = BriefFile(self._part / self._names[slot])
        return cast("BinaryIO", self._files[slot])

    def complete(self, names: TableNames) -> dict[str, str]:
        """Let the tables take their places and return the name of each message's file.

        Those of messages that did not occur, of an earlier time, are gone.
        """
        for file in self._files.values():
            file.flush()
        for slot, name in self._names.items():
            if slot not in self._files:
                (self._folder / name).unlink(missing_ok=True)
        for slot in self._files:
            (self._part / self._names[slot]).replace(self._folder / self._names[slot])
        return {names.messages[slot]: self._names[slot] for slot in sorted(self._files)}

    def forget(self) -> None:
        """Hold nothing any more."""
        for file in self._files.values():
            file.forget()


@contextmanager
def table_folder(folder: Path, names: Mapping[int, str]) -> Iterator[TableFolder]:
    """Give the folder in which the tables of messages are written, made if need be, and leave nothing unfinished.

    Raises OutputError if it cannot be written to.

    Parameters
    ----------
    folder
        Where they shall be.
    names
        Of the files of messages, by slot.
    """
    part = folder / f".{os.getpid()}-{next(_NUMBERS)}.part"
    is_new = not is_there(folder)
    try:
        folder.mkdir(exist_ok=True)
        part.mkdir()
        tables = TableFolder(folder, part, names)
        try:
            yield tables
        finally:
            tables.forget()
    except OSError as exc:
        raise OutputError(f"cannot write {folder}: {exc.strerror or exc}") from exc
    finally:
        shutil.rmtree(part, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # there is something in it
                folder.rmdir()


def message_files(names: TableNames, table_format: TableFormat) -> dict[int, str]:
    suffix = SUFFIX_OF_FORMAT[table_format]
    return {slot: f"{name}{suffix}" for slot, name in enumerate(file_names(names.messages))}


def tables_there(folder: Path, names: Mapping[int, str]) -> list[Path]:
    """Return which tables of messages are in a folder already."""
    return [path for name in names.values() if is_plain_file(path := folder / name)]
