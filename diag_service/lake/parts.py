"""The files of a lake: parts by date and vehicle, and a manifest of what was made of which log.

Rows of the manifest are only ever added, and now and then put together. A file of rows has a generation in its name,
and of a log the row of the latest generation holds. So nothing is written over, whoever was killed, and a log that two
files tell of is in the lake once.
"""

import hashlib
import io
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from canlog.column_files import TIME_TYPE, ParquetTable, TableFormat, load_pyarrow
from canlog.errors import DefinitionError, SourceError
from canlog.logs import read_log
from canlog.tables.decoding import Plan, decode_logs
from diag_service.batch.tables import BATCH_ROWS, columns, flattened
from diag_service.diagnosis.records import iso_utc, utc_from_bus_ns
from diag_service.errors import ConfigError, StoreError
from diag_service.lake.places import Held, Place
from fleet_contract import JsonObject

FOLDER: Final = "manifest"
DONE, FAILED = "done", "failed"
FULL_ROWS: Final = 50_000  # of a file of the manifest that nothing is put into any more
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

    What logs said of themselves, by far the most of a row, stays in the files: ``account`` is empty here. A file that
    is full is left as it is, so that a run writes anew no more than the last.

    Raises StoreError if a file of it is none.
    """

    def __init__(self, place: Place, full_rows: int = FULL_ROWS) -> None:
        self._place = place
        self._full_rows = full_rows
        self._rows: dict[str, LogRow] = {}
        self._files: dict[str, int] = {}  # how many rows each has
        self._file_of: dict[str, str] = {}  # of the row that holds
        self._generation = 0
        for name in place.held(FOLDER):
            self._generation = max(self._generation, _generation_of(name))
            self._files[name] = 0
            for rows in _parsed(place.read(name), name, [one for one in manifest_columns() if one != "account"]):
                self._take(rows, name)
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
            self._write([rows])

    def put_together(self, *, without: Iterable[str] = ()) -> None:
        """Write one file in place of those that are not full; without the rows of some logs, wherever they are."""
        gone = self._rows.keys() & set(without)
        small = [name for name, count in self._files.items() if count < self._full_rows]
        batches = [[name] for name in self._files if name not in small] if gone else []
        batches += [small] if len(small) > 1 or gone else []
        for source in gone:
            del self._rows[source], self._file_of[source]
        for names in batches:
            self._write(self._holding(names))
            self._place.remove(names)
            self._files = {name: count for name, count in self._files.items() if name not in names}

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

    def _take(self, rows: Sequence[LogRow], name: str) -> None:
        self._rows |= {row.source: replace(row, account="") for row in rows}
        self._file_of |= dict.fromkeys((row.source for row in rows), name)
        self._files[name] += len(rows)

    def _holding(self, names: Sequence[str]) -> Iterator[list[LogRow]]:
        """Yield the rows of some files that hold, whole."""
        for name in names:
            for rows in _parsed(self._place.read(name), name, list(manifest_columns())):
                yield [row for row in rows if self._file_of.get(row.source) == name]

    def _write(self, groups: Iterable[Sequence[LogRow]]) -> None:
        self._generation += 1
        taken = list[Sequence[LogRow]]()
        with TemporaryDirectory(prefix="clutchdiag-") as folder:
            path = Path(folder) / "rows"
            with path.open("wb") as stream, ParquetTable(stream, manifest_columns()) as table:
                for rows in filter(None, groups):
                    table.write_rows([{**asdict(row), "parts": _SEPARATOR.join(row.parts)} for row in rows])
                    taken.append([replace(row, account="") for row in rows])
            if not taken:
                return
            name = f"{FOLDER}/{self._generation:010}-{content_digest(path)[:16]}.parquet"
            self._place.put(name, path)
        self._files[name] = 0
        for rows in taken:
            self._take(rows, name)


def manifest_columns() -> dict[str, str]:
    """Return the columns of the manifest and their types; ``parts`` are names, separated by semicolons."""
    return {field.name: _TYPES.get(field.name, "string") for field in fields(LogRow)}


def _generation_of(name: str) -> int:
    number = name.removeprefix(f"{FOLDER}/").partition("-")[0]
    if not number.isdecimal():
        raise StoreError(f"{name} is not a file of a manifest")
    return int(number)


def _parsed(content: bytes, name: str, wanted: list[str]) -> Iterator[list[LogRow]]:
    """Yield the rows of a file, some at a time; a column that is not wanted is empty."""
    arrow = load_pyarrow()
    try:
        # By this thread alone: threads of Arrow that outlive a short program abort it.
        file = arrow.parquet.ParquetFile(io.BytesIO(content))
        for batch in file.iter_batches(BATCH_ROWS, columns=wanted, use_threads=False):
            yield [_row(row) for row in batch.to_pylist()]
    except (arrow.ArrowException, KeyError, TypeError) as exc:
        raise StoreError(f"{name} is not a file of a manifest: {exc}") from exc


def _row(row: dict[str, Any]) -> LogRow:
    same = {name: sys.intern(row[name]) for name in ("vehicle", "settings", "signals", "algorithm_version", "outcome")}
    parts = tuple(filter(None, row["parts"].split(_SEPARATOR)))
    return LogRow(**{"account": "", **row, **same, "parts": parts, "made_at": iso_utc(row["made_at"])})


SHIFTS, SIGNALS = "shifts", "signals"
NAME_DIGITS: Final = 32  # of a sha256: enough that no two logs share a name
SETTINGS_DIGITS: Final = 16
_BLOCK_BYTES: Final = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Forgotten:
    """What was taken out of a lake."""

    vehicle: str
    parts: tuple[str, ...]
    part_bytes: int
    rows: int  # of the manifest
    shifts: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """What of manifest and parts has no counterpart; a lake that is as it should be has neither."""

    missing: tuple[str, ...]  # parts that a row speaks of
    unknown: tuple[str, ...]  # parts that no row speaks of
    twice: tuple[str, ...]  # logs whose shifts are in more than one state


def parts_of(lake: Place, *, with_unfinished: bool = False) -> dict[str, Held]:
    """Return all parts of a lake, if asked for with those that a killed process has not finished."""
    shifts, signals = (lake.held(kind, with_unfinished=with_unfinished) for kind in (SHIFTS, SIGNALS))
    return shifts | signals


def forget(lake: Place, vehicle: str) -> Forgotten:
    """Take one vehicle out of a lake: its parts, whoever made them, its rows, its folders; then look again.

    Logs that are not in the lake, and copies that others made of it, stay.

    Raises StoreError if anything of the vehicle is still there afterwards.
    """
    manifest = Manifest(lake)
    rows = [row for row in manifest.rows if row.vehicle == vehicle]
    found = _of(vehicle, lake)
    lake.remove(found)
    manifest.put_together(without=[row.source for row in rows])
    folders = [name for kind in (SHIFTS, SIGNALS) for name in lake.remove_folders(f"{kind}/*/{_folder(vehicle)}")]
    left = [*_of(vehicle, lake), *folders, *(row.source for row in Manifest(lake).rows if row.vehicle == vehicle)]
    if left:
        raise StoreError(f"{len(left)} things of {vehicle} are still in {lake.address}, the first: {left[0]}")
    return Forgotten(
        vehicle=vehicle,
        parts=tuple(found),
        part_bytes=sum(one.size_bytes for one in found.values()),
        rows=len(rows),
        shifts=sum(row.shifts for row in rows),
    )


def disagreement(lake: Place) -> Disagreement:
    """Return in what manifest and parts disagree."""
    rows, there = Manifest(lake).rows, set(parts_of(lake))
    known = {part for row in rows for part in row.parts}
    shifts: dict[tuple[str, str], set[str]] = {}
    for row in rows:
        if row.outcome == DONE:
            shifts.setdefault((row.content, row.vehicle), set()).add(row.settings)
    twice = sorted({content for (content, _), settings in shifts.items() if len(settings) > 1})
    return Disagreement(missing=tuple(sorted(known - there)), unknown=tuple(sorted(there - known)), twice=tuple(twice))


def _of(vehicle: str, lake: Place) -> dict[str, Held]:
    parts = parts_of(lake, with_unfinished=True)
    return {name: one for name, one in parts.items() if f"/{_folder(vehicle)}/" in name}


def _folder(vehicle: str) -> str:
    return f"vehicle={vehicle}"


def content_digest(path: Path) -> str:
    """Return the sha256 of a file; raises SourceError if it cannot be read."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
    except OSError as exc:
        raise SourceError(f"cannot read {path}: {exc.strerror or exc}") from exc
    return digest.hexdigest()


def part_name(kind: str, date: str, vehicle: str, content: str, settings: str) -> str:
    """Return the name of a part: it says what is in it, so whoever makes it again makes the same file."""
    name = f"{content[:NAME_DIGITS]}-{settings[:SETTINGS_DIGITS]}.parquet"
    return f"{kind}/date={date}/vehicle={vehicle}/{name}"


def date_of(moment: object) -> str:
    """Return the day, in UTC, of a moment in ISO 8601."""
    return str(moment)[:10]


def by_date(shifts: Sequence[JsonObject]) -> Mapping[str, list[JsonObject]]:
    """Return shifts by the day on which they began."""
    days: dict[str, list[JsonObject]] = defaultdict(list)
    for shift in shifts:
        days[date_of(shift["start_utc"])].append(shift)
    return days


def write_shifts(path: Path, content: str, shifts: Sequence[tuple[JsonObject, bool]]) -> None:
    """Write shifts of the log of a digest, each with whether its log was complete, as one part.

    Their ``path`` is the digest: a part depends on its content alone, and the manifest tells where that lies. Rows are
    in order of time, so that a reader who looks for a time or a vehicle skips most row groups by their statistics.
    """
    rows = sorted(
        ({"path": f"sha256:{content}", "complete": is_complete, **flattened(shift)} for shift, is_complete in shifts),
        key=lambda row: str(row["start_utc"]),
    )
    with path.open("wb") as stream, ParquetTable(stream, columns()) as table:
        for group in _groups(rows):
            table.write_rows(group)


def signal_plan(plan: Plan, patterns: str) -> Plan:
    """Return the plan for the signals that are asked for, separated by commas; raises ConfigError if there are none."""
    wanted = [one.strip() for one in patterns.split(",") if one.strip()]
    try:
        return replace(plan.part(wanted, None, None))
    except DefinitionError as exc:
        raise ConfigError(str(exc)) from exc


def first_date(path: Path, log_columns: str) -> str:
    """Return the day, in UTC, on which a log begins; raises SourceError if it cannot be read or holds no frame."""
    with closing(read_log(path, columns=log_columns)) as reader:
        return date_of(utc_from_bus_ns(int(next(reader).t_ns[0])))


def write_signals(path: Path, log: Path, plan: Plan, log_columns: str) -> None:
    """Write the decoded signals of a log as one part; raises SourceError if the log cannot be read."""
    decode_logs([log], plan, path, TableFormat.PARQUET, columns=log_columns)


def _groups(rows: Sequence[Mapping[str, object]]) -> Iterator[list[Mapping[str, object]]]:
    remaining = iter(rows)
    while group := list(islice(remaining, BATCH_ROWS)):
        yield group
