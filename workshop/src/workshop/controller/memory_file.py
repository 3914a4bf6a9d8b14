"""What a controller keeps without current: trouble codes, written data and wrong keys, in a file that survives a kill.

The file is replaced as a whole, after its bytes have reached the disk: at any moment it is the old one or the new one.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self

import msgspec

from canlog.files import read_small_file
from clutchdiag_io.files import OPEN_FLAGS, PRIVATE_MODE, lock
from ecu_emulator.errors import RecordError
from ecu_emulator.shift_control.touch_points import TouchPoint
from workshop.controller.clutches import CLUTCHES, Adaptation
from workshop.controller.iso14229 import Status
from workshop.controller.memory import (
    MOST_COUNT,
    MOST_CYCLES,
    Capture,
    Emissions,
    FreezeFrame,
    TroubleMemory,
    TroubleRecord,
    empty_memory,
)
from workshop.controller.state import ServerState
from workshop.controller.table import DiagnosticTable

FORMAT: Final = 1
MOST_PRESSURE_PA: Final = 1e7  # what a file may say of a touch point
_EMISSIONS: Final = ("warm_ups", "cleared_at_m", "lamp_at_m", "is_driven", "driven_cycles")
_COUNTERS: Final = ("occurrences", "failed_cycles", "passed_cycles", "aged_cycles")


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
        self._saved: object = None
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
        self._saved = document
        try:
            return _state(document, self._table)
        except (KeyError, TypeError, ValueError, AttributeError) as exc:
            raise self._damaged(f"{type(exc).__name__} {exc}") from exc
        except RecordError as exc:
            raise RecordError(f"{self._path}: {exc}") from exc

    def save(self, state: ServerState) -> None:
        """Write what is to be kept, if it has changed; it is on the disk when this returns.

        Raises RecordError if the disk is full or cannot be written; the file is as it was before.
        """
        document = msgspec.json.decode(msgspec.json.encode(_document(state)))  # a number that is none becomes null
        if document == self._saved:
            return
        temporary = self._beside("part")
        text = json.dumps({**document, "sha256": _digest(document)}, indent=1, sort_keys=True)
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
        self._saved = document

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


def _document(state: ServerState) -> dict[str, Any]:
    memory, emissions, frame = state.memory, state.emissions, state.emissions.frame
    return {
        "format": FORMAT,
        "has_begun": memory.has_begun,
        "is_warmed_up": memory.is_warmed_up,
        "codes": {f"{number:06X}": _record_document(record) for number, record in memory.records.items()},
        "written": {f"{number:04X}": data.hex() for number, data in state.written.items()},
        "wrong_keys": state.wrong_keys,
        "obd": {
            "permanent": sorted(f"{number:06X}" for number in emissions.permanent),
            "frame": None if frame is None else {"code": f"{frame.code:06X}", "pids": _digits(frame.pids)},
            **{name: getattr(emissions, name) for name in _EMISSIONS},
            "ran_cycles": {f"{number:06X}": count for number, count in emissions.ran_cycles.items()},
        },
        "adaptation": state.adaptation,
    }


def _record_document(record: TroubleRecord) -> dict[str, Any]:
    captures = {
        name: None if one is None else {"snapshot": _digits(one.snapshot), "extended": _digits(one.extended)}
        for name, one in (("first", record.first), ("latest", record.latest))
    }
    return {"status": int(record.status), **{name: getattr(record, name) for name in _COUNTERS}, **captures}


def _digits(kept: tuple[tuple[int, bytes], ...]) -> list[tuple[int, str]]:
    return [(number, data.hex()) for number, data in kept]


def _state(document: Mapping[str, Any], table: DiagnosticTable) -> ServerState:
    records = {int(code, 16): _record(entry) for code, entry in document["codes"].items()}
    written = {int(number, 16): bytes.fromhex(data) for number, data in document["written"].items()}
    wrong_keys = {int(level): _count(count) for level, count in document["wrong_keys"].items()}
    if unknown := sorted(records.keys() - table.troubles.keys()):
        raise RecordError(f"trouble code {unknown[0]:06X} is not in the table {table.name}")
    for number, data in written.items():
        datum = table.data.get(number)
        if datum is None or datum.write is None or len(data) != datum.size_bytes:
            raise RecordError(f"data {number:04X} of {len(data)} bytes cannot be written by the table {table.name}")
    if unknown := sorted(wrong_keys.keys() - table.levels.keys()):
        raise RecordError(f"security level {unknown[0]} is not in the table {table.name}")
    memory = TroubleMemory(
        records={**empty_memory(table.troubles).records, **records},
        has_begun=bool(document["has_begun"]),
        is_warmed_up=bool(document["is_warmed_up"]),
    )
    return ServerState(
        memory=memory,
        emissions=_emissions(document["obd"], table),
        written=written,
        wrong_keys=wrong_keys,
        adaptation=_adaptation(document["adaptation"]),
    )


def _adaptation(entry: Mapping[str, Any] | None) -> Adaptation | None:
    """Return what was adapted, if anything was."""
    if entry is None:
        return None
    points = {
        int(clutch): TouchPoint(
            pressure_pa=_pressure_pa(told["pressure_pa"]),
            std_pa=math.nan if told["std_pa"] is None else _pressure_pa(told["std_pa"]),
            is_at_limit=bool(_count(told["is_at_limit"])),
        )
        for clutch, told in entry["touch_points"].items()
    }
    if not set(points) <= set(CLUTCHES):
        raise ValueError(f"not clutches: {sorted(points)}")
    return Adaptation(touch_points=points)


def _pressure_pa(value: object) -> float:
    if not isinstance(value, int | float) or not 0.0 <= value <= MOST_PRESSURE_PA:
        raise ValueError(f"not a pressure: {value!r}")
    return float(value)


def _emissions(entry: Mapping[str, Any], table: DiagnosticTable) -> Emissions:
    """Return what was kept for OBD."""
    frame = entry["frame"]
    codes = [int(code, 16) for code in (*entry["permanent"], *([] if frame is None else [frame["code"]]))]
    if unknown := sorted(set(codes) - table.troubles.keys()):
        raise RecordError(f"trouble code {unknown[0]:06X} is not in the table {table.name}")
    return Emissions(
        permanent=frozenset(int(code, 16) for code in entry["permanent"]),
        frame=None
        if frame is None
        else FreezeFrame(
            code=int(frame["code"], 16), pids=tuple((int(pid), bytes.fromhex(data)) for pid, data in frame["pids"])
        ),
        warm_ups=_count(entry["warm_ups"]),
        cleared_at_m=_distance_m(entry["cleared_at_m"]),
        lamp_at_m=_distance_m(entry["lamp_at_m"]),
        is_driven=bool(entry["is_driven"]),
        driven_cycles=_count(entry["driven_cycles"], MOST_CYCLES),
        ran_cycles={int(code, 16): _count(one, MOST_CYCLES) for code, one in entry["ran_cycles"].items()},
    )


def _record(entry: Mapping[str, Any]) -> TroubleRecord:
    return TroubleRecord(
        status=Status(_count(entry["status"])),
        **{name: _count(entry[name]) for name in _COUNTERS},
        first=_capture(entry["first"]),
        latest=_capture(entry["latest"]),
    )


def _capture(entry: Mapping[str, Any] | None) -> Capture | None:
    if entry is None:
        return None
    return Capture(
        snapshot=tuple((int(number), bytes.fromhex(data)) for number, data in entry["snapshot"]),
        extended=tuple((int(number), bytes.fromhex(data)) for number, data in entry["extended"]),
    )


def _distance_m(value: object) -> float | None:
    if value is not None and (not isinstance(value, int | float) or not math.isfinite(value)):
        raise ValueError(f"not a distance: {value!r}")
    return value


def _count(value: object, most: int = MOST_COUNT) -> int:
    if not isinstance(value, int) or not 0 <= value <= most:
        raise ValueError(f"not a count: {value!r}")
    return value
