"""What a controller keeps without current: trouble codes, written data and wrong keys, in a file that survives a kill.

The file is replaced as a whole, after its bytes have reached the disk: at any moment it is the old one or the new one.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self

import msgspec

from canlog.files import read_small_file
from clutchdiag_io.files import OPEN_FLAGS, PRIVATE_MODE, lock
from ecu_emulator.errors import RecordError
from workshop.controller.clutches import Adaptation
from workshop.controller.memory import Emissions, TroubleMemory, empty_memory
from workshop.controller.state import ServerState
from workshop.controller.table import DiagnosticTable

FORMAT: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """What outlives a restart; whether an operation cycle's test is under way does not."""

    memory: TroubleMemory
    emissions: Emissions
    written: Mapping[int, bytes]
    wrong_keys: Mapping[int, int]
    adaptation: Adaptation | None


class MemoryFile:
    """The file of one controller; while it is open, no other process can use it.

    Parameters
    ----------
    path
        Where it is, or shall be.
    table
        What the controller knows: the file may hold nothing else.

    Raises
    ------
    RecordError
        If another process uses the file, or it cannot be made.
    """

    def __init__(self, path: Path, table: DiagnosticTable) -> None:
        self._path = path
        self._table = table
        self._saved = ""  # its digest
        self._lock = -1

    def __enter__(self) -> Self:
        try:
            self._lock = os.open(self._beside("lock"), OPEN_FLAGS, PRIVATE_MODE)
            lock(self._lock)
        except BlockingIOError as exc:
            os.close(self._lock)
            raise RecordError(f"{self._path} is used by another process") from exc
        except OSError as exc:
            raise RecordError(f"cannot lock {self._path}: {exc.strerror}") from exc
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._lock)

    def load(self) -> ServerState | None:
        """Return what was kept, None if there is no file yet.

        Raises RecordError if the file cannot be read, is damaged, or holds what the table does not describe.
        """
        try:
            document = json.loads(read_small_file(self._path))
        except FileNotFoundError:
            return None
        except OSError as exc:
            raise RecordError(f"cannot read {self._path}: {exc.strerror or exc}") from exc
        except (ValueError, RecursionError) as exc:
            raise self._damaged("not JSON") from exc
        digest = document.pop("sha256", None) if isinstance(document, dict) else ""
        if digest != _digest(document):
            raise self._damaged("its checksum does not fit")
        if document.get("format") != FORMAT:
            raise RecordError(f"{self._path} has format {document.get('format')}, this program knows {FORMAT}")
        self._saved = digest
        try:
            return _state(msgspec.convert(document.get("kept"), Kept, str_keys=True), self._table)
        except msgspec.ValidationError as exc:
            raise self._damaged(str(exc)) from exc
        except RecordError as exc:
            raise RecordError(f"{self._path}: {exc}") from exc

    def save(self, state: ServerState) -> None:
        """Write what is to be kept, if it has changed; it is on the disk when this returns.

        Raises RecordError if the disk is full or cannot be written; the file is as it was before.
        """
        kept = msgspec.to_builtins(_kept(state), str_keys=True, order="deterministic")
        document = json.loads(json.dumps({"format": FORMAT, "kept": kept}))
        if (digest := _digest(document)) == self._saved:
            return
        temporary = self._beside("part")
        text = json.dumps({**document, "sha256": digest}, indent=1, sort_keys=True)
        try:
            descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, PRIVATE_MODE)
            with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
                stream.write(text + "\n")
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(self._path)
            _sync_folder(self._path.absolute().parent)
        except OSError as exc:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise RecordError(f"cannot write {self._path}: {exc.strerror or exc}") from exc
        self._saved = digest

    def _beside(self, suffix: str) -> Path:
        return self._path.with_name(f".{self._path.name}.{suffix}")

    def _damaged(self, why: str) -> RecordError:
        return RecordError(f"{self._path} is damaged ({why}); move it away to begin with an empty memory")


def _sync_folder(folder: Path) -> None:
    """Make a new name durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _digest(document: object) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode("utf-8")).hexdigest()


def _kept(state: ServerState) -> Kept:
    records = {code: replace(record, detection_counter=0) for code, record in state.memory.records.items()}
    return Kept(
        memory=replace(state.memory, records=records),
        emissions=state.emissions,
        written=state.written,
        wrong_keys=state.wrong_keys,
        adaptation=state.adaptation,
    )


def _state(kept: Kept, table: DiagnosticTable) -> ServerState:
    """Return what was kept as the state of a controller; raises RecordError if the table does not describe it."""
    emissions = kept.emissions
    codes = {*kept.memory.records, *emissions.permanent, *([emissions.frame.code] if emissions.frame else [])}
    if unknown := sorted(codes - table.troubles.keys()):
        raise RecordError(f"trouble code {unknown[0]:06X} is not in the table {table.name}")
    for number, data in kept.written.items():
        datum = table.data.get(number)
        if datum is None or datum.write is None or len(data) != datum.size_bytes:
            raise RecordError(f"data {number:04X} of {len(data)} bytes cannot be written by the table {table.name}")
    if unknown := sorted(kept.wrong_keys.keys() - table.levels.keys()):
        raise RecordError(f"security level {unknown[0]} is not in the table {table.name}")
    records = {**empty_memory(table.troubles).records, **kept.memory.records}
    return ServerState(
        memory=replace(kept.memory, records=records),
        emissions=emissions,
        written=kept.written,
        wrong_keys=kept.wrong_keys,
        adaptation=kept.adaptation,
    )
