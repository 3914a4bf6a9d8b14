"""The files of a lake and the places that hold them: parts by date and vehicle, a manifest of what was made of what.

Rows of the manifest are only ever added, and now and then put together. A file of rows has a generation in its name,
and of a log the row of the latest generation holds. So nothing is written over, whoever was killed, and a log that two
files tell of is there once.
"""

import logging
import os
import shutil
import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final

from canlog.column_files import TIME_TYPE, arrow_schema, load_pyarrow, row_table
from canlog.errors import DefinitionError, SourceError
from canlog.extras import load_extra
from canlog.files import replacing
from canlog.logs import read_log
from canlog.tables.decoding import Plan
from clutch_results.records import iso_utc, utc_from_bus_ns
from diag_service.batch.tables import flattened, write_parquet
from diag_service.errors import ConfigError, StoreError
from diag_service.service.drive import stream_of
from fleet_contract import JsonObject

UNFINISHED: Final = ".part"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """A file in a place, as it was when it was looked at."""

    name: str  # below the place, parts separated by /
    size_bytes: int
    mark: str  # differs when the content was written anew: entity tag or time of change


class Place:
    """A folder of this machine, or of an object store; what is put there appears whole or not at all.

    In a folder a file is written aside, synced and renamed. In an object store a put is atomic by itself.

    Raises ConfigError if the address names no place, ExtraMissingError if the library for it is not installed, and
    from every method StoreError if the store does not do what is asked.
    """

    def __init__(self, address: str) -> None:
        if "::" in address:
            raise ConfigError(f"{address}: one store at a time, not one inside another")
        core = load_extra("fsspec.core", "a store needs fsspec", "cluster", ".")
        below = load_extra("fsspec.implementations.dirfs", "a store needs fsspec", "cluster", ".")
        if "://" not in address:
            address = str(Path(address).absolute())
        try:
            files, root = core.url_to_fs(address, use_listings_cache=False)
        except ImportError as exc:
            raise ConfigError(f"{address}: {exc}") from exc
        except (ValueError, OSError, TypeError) as exc:
            raise ConfigError(f"{address} is not a store: {exc}") from exc
        self._files = below.DirFileSystem(root.rstrip("/"), files)  # names are below the place
        self.address = address.rstrip("/")
        self.is_local = "file" in ((files.protocol,) if isinstance(files.protocol, str) else files.protocol)

    def held(self, under: str = "", *, with_unfinished: bool = False) -> dict[str, Held]:
        """Return the files below, by name; none where there is no such folder.

        What a killed process has not finished writing is none of them, unless it is asked for. A folder of this machine
        into which this user may not look is told.

        Raises StoreError if the folder itself is one.
        """
        with _translated("look into", self.address):
            try:
                self._files.invalidate_cache()
                listed = self._walked(under) if self.is_local else self._files.find(under, detail=True)
            except FileNotFoundError:
                return {}
        held = dict[str, Held]()
        for name, info in sorted(listed.items()):
            if name and info["type"] == "file" and (with_unfinished or not name.endswith(UNFINISHED)):
                mark = info.get("ETag") or info.get("etag") or info.get("mtime") or info.get("updated") or ""
                held[name] = Held(name=name, size_bytes=int(info["size"]), mark=str(mark))
        return held

    @contextmanager
    def opened(self, name: str) -> Iterator[Any]:
        """Give a file for reading."""
        with _translated("read", self._shown(name)), self._files.open(name, "rb") as file:
            yield file

    def fetched(self, name: str, folder: Path) -> Path:
        """Return where a file lies on this machine, in ``folder`` if it came from elsewhere.

        Raises SourceError, too, if this file alone has gone or is archived: the store still answers.
        """
        if self.is_local:
            return Path(self._files.path, name)
        path = folder / PurePosixPath(name).name
        with _translated("read", self._shown(name)):
            try:
                self._files.get_file(name, str(path))
            except (FileNotFoundError, PermissionError) as exc:
                with suppress(FileNotFoundError):
                    self._files.info(name)  # where the store tells nothing any more, it is not about one file
                raise SourceError(f"cannot read {self._shown(name)}: {exc}") from exc
        return path

    def put(self, name: str, source: Path) -> None:
        """Copy a file there; it takes the place of one of that name."""
        with _translated("write", self._shown(name)):
            if not self.is_local:
                self._files.put_file(str(source), name)
                return
            path = Path(self._files.path, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path, StoreError) as part:
                with source.open("rb") as read, part.open("wb") as written:
                    shutil.copyfileobj(read, written)
                    written.flush()
                    os.fsync(written.fileno())
                part.replace(path)

    def remove(self, names: Iterable[str]) -> None:
        """Remove files, of which some may be gone, and on this machine the folders that then hold nothing."""
        for name in names:
            with _translated("remove", self._shown(name)), suppress(FileNotFoundError):
                self._files.rm_file(name)
            if self.is_local:
                with suppress(OSError):  # it holds something
                    Path(self._files.path, name).parent.rmdir()

    def _shown(self, name: str) -> str:
        return f"{self.address}/{name}"

    def _walked(self, under: str) -> dict[str, Any]:
        """Return the files below a folder of this machine; fsspec tells of no folder that it may not read."""
        top, listed = Path(self._files.path, under), dict[str, Any]()

        def tell(error: OSError) -> None:
            if not isinstance(error, PermissionError):  # it is not there, or has gone meanwhile
                return
            if Path(error.filename) == top:
                raise StoreError(f"cannot look into {top}: {error.strerror}") from error
            _LOG.warning("left out: %s: %s", error.filename, error.strerror)

        for folder, _, names in os.walk(top, onerror=tell):
            for name in (Path(folder, name).relative_to(self._files.path).as_posix() for name in names):
                listed[name] = {"type": "file", "size": 0}
                with suppress(FileNotFoundError):  # a link that leads nowhere: a file that nobody can read
                    listed[name] = self._files.info(name)
        return listed


@contextmanager
def _translated(verb: str, what: str) -> Iterator[None]:
    """Raise StoreError in place of what a library raises."""
    try:
        yield
    except (SourceError, StoreError):
        raise
    except Exception as exc:  # each library of a store has errors of its own, without a common root
        raise StoreError(f"cannot {verb} {what}: {exc or type(exc).__name__}") from exc


FOLDER: Final = "manifest"
DONE, FAILED = "done", "failed"
ROWS_PER_FILE: Final = 256
FILE_EVERY_S: Final = 5.0
FULL_ROWS: Final = 50_000  # of a file that is not put together with others any more
_SEPARATOR: Final = ";"
_TYPES: Final = {"size_bytes": "int64", "shifts": "int64", "made_at": TIME_TYPE}


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
    parts: tuple[str, ...]  # the files that were made of it
    account: str  # what it said, as JSON
    made_at: str  # ISO 8601 UTC


COLUMNS: Final = {
    column.name: _TYPES.get(column.name, "string") for column in fields(LogRow)
}  # `parts` joined by semicolons
_DEFAULTS: Final = {column.name: column.default for column in fields(LogRow) if column.default is not MISSING}


class Manifest:
    """The rows of a lake, as they were and as they became since.

    What logs said of themselves, by far the most of a row, stays in the files: ``account`` is empty here. Rows are
    added in files of their own. A file that is full stays as it is; those that are not are put together.

    Raises StoreError if a file of it is none.
    """

    def __init__(self, place: Place, full_rows: int = FULL_ROWS) -> None:
        self._place = place
        self._full_rows = full_rows
        self._rows: dict[str, LogRow] = {}
        self._file_of: dict[str, str] = {}  # of the row that holds
        self._counts: dict[str, int] = {}  # of rows, by file
        self._noted: list[LogRow] = []
        self._due_s = 0.0
        narrow = [column for column in COLUMNS if column != "account"]
        for name in sorted(place.held(FOLDER), key=_generation_of):
            self._take([_row(row) for row in _table(place, name, narrow).to_pylist()], name)

    @property
    def rows(self) -> tuple[LogRow, ...]:
        """The rows that hold, in no order."""
        return tuple(self._rows.values())

    def row(self, source: str) -> LogRow | None:
        return self._rows.get(source)

    def add(self, rows: Sequence[LogRow]) -> None:
        """Write rows as one more file; those of the same logs hold no longer."""
        if rows:
            records = ({name: getattr(row, name) for name in COLUMNS} for row in rows)
            plain = [{**row, "parts": _SEPARATOR.join(row["parts"])} for row in records]
            name = self._write([row_table(plain, arrow_schema(COLUMNS))], self._next_generation())
            self._take(rows, name)

    def forget(self, vehicle: str) -> None:
        """Write the files anew in which a vehicle is, without it."""
        for name in self._counts:
            table = _table(self._place, name)
            others = table.filter(load_pyarrow().compute.not_equal(table["vehicle"], vehicle))
            if others.num_rows < table.num_rows:
                self._place.remove({name} - {self._write([others], _generation_of(name))})

    def put_together(self) -> None:
        """Write one file in place of those that are not full."""
        small = [name for name, count in self._counts.items() if count < self._full_rows]
        if len(small) > 1:
            self._write((self._holding(name) for name in small), self._next_generation())
            self._place.remove(small)

    def note(self, row: LogRow) -> None:
        """Take the row of a log whose parts are there; many are written at once."""
        self._due_s = self._due_s if self._noted else time.monotonic() + FILE_EVERY_S
        self._noted.append(row)
        if len(self._noted) >= ROWS_PER_FILE or time.monotonic() >= self._due_s:
            self.close()

    def close(self) -> None:
        """Write what was noted, and the rows of its copies, in place of parts of before."""
        rows = [*self._noted, *copies(self.rows, self._noted)]
        self._noted = []
        self._place.remove(self.superseded(rows))  # first: a kill after it leaves a row that is made anew
        self.add(rows)

    def superseded(self, rows: Iterable[LogRow]) -> list[str]:
        """Return the parts of which no row speaks any more once these rows are added."""
        new = {row.source: row for row in rows}
        before = {part for source in new.keys() & self._rows.keys() for part in self._rows[source].parts}
        return sorted(before.difference(*(row.parts for row in (self._rows | new).values())))

    def _take(self, rows: Sequence[LogRow], name: str) -> None:
        self._counts[name] = len(rows)
        for row in rows:
            self._rows[row.source], self._file_of[row.source] = replace(row, account="") if row.account else row, name

    def _holding(self, name: str) -> Any:  # noqa: ANN401 - a table of an untyped library
        table = _table(self._place, name)
        holds = [self._file_of[source] == name for source in table["source"].to_pylist()]
        return table.filter(load_pyarrow().array(holds, "bool"))

    def _next_generation(self) -> int:
        return max(map(_generation_of, self._counts), default=0) + 1

    def _write(self, tables: Iterable[Any], generation: int) -> str:
        """Write tables as one file; return its name, empty if there is none."""
        schema, rows = arrow_schema(COLUMNS), 0
        with TemporaryDirectory(prefix="clutchdiag-") as folder:
            path = Path(folder) / "rows"
            with load_pyarrow().parquet.ParquetWriter(path, schema, compression="zstd") as writer:
                for table in tables:
                    writer.write_table(table.select(schema.names).cast(schema))
                    rows += table.num_rows
            name = f"{FOLDER}/{generation:010}-{stream_of([path])[:16]}.parquet" if rows else ""
            if name:
                self._place.put(name, path)
        return name


def copies(rows: Iterable[LogRow], made: Iterable[LogRow]) -> list[LogRow]:
    """Return rows of logs with the content of one made anew, in its state: nobody finds one that was moved again."""
    anew = {(row.content, row.vehicle): row for row in made if row.outcome == DONE}
    sources, anew_rows = {row.source for row in made}, list[LogRow]()
    for old in rows:
        new = anew.get((old.content, old.vehicle))
        if new is None or old.outcome != DONE or old.source in sources or old.settings == new.settings:
            continue
        parts = (part for row, kind in ((new, SHIFTS), (old, SIGNALS)) for part in row.parts if part.startswith(kind))
        anew_rows.append(replace(new, source=old.source, key=old.key, signals=old.signals, parts=tuple(parts)))
    return anew_rows


def mend(place: Place, missing: Collection[str]) -> None:
    """Let rows of one content be in the state that was made last, and the next run make anew what is missing."""
    manifest, absent = Manifest(place), set(missing)
    done = sorted((row for row in manifest.rows if row.outcome == DONE), key=lambda row: row.made_at)
    last = {(row.content, row.vehicle): row for row in done}
    lost = [replace(row, key="") for row in manifest.rows if not absent.isdisjoint(row.parts)]
    changed = {row.source: row for row in (*copies(manifest.rows, last.values()), *lost)}
    manifest.add([replace(row, account='{"logs":[]}') for row in changed.values()])


def _generation_of(name: str) -> int:
    number = name.rpartition("/")[2].partition("-")[0]
    if not number.isdecimal():
        raise StoreError(f"{name} is not a file of a manifest")
    return int(number)


def _table(place: Place, name: str, columns: list[str] | None = None) -> Any:  # noqa: ANN401 - of an untyped library
    """Return columns of a file of the manifest; one that earlier programs did not write holds its default."""
    arrow = load_pyarrow()
    try:
        with place.opened(name) as file:
            # By this thread alone: threads of Arrow that outlive a short program abort it.
            table = arrow.parquet.ParquetFile(file).read(columns, use_threads=False)
    except StoreError as exc:
        raise StoreError(f"{name} is not a file of a manifest: {exc}") from exc
    missing = set(columns or COLUMNS).difference(table.column_names)
    if needed := missing.difference(_DEFAULTS):
        raise StoreError(f"{name} is not a file of a manifest: no {min(needed)}")
    for absent in missing:
        table = table.append_column(absent, arrow.array([_DEFAULTS[absent]] * table.num_rows))
    return table


def _row(row: dict[str, Any]) -> LogRow:
    parts = tuple(filter(None, row["parts"].split(_SEPARATOR)))
    return LogRow(**{"account": "", **row, "parts": parts, "made_at": iso_utc(row["made_at"])})


SHIFTS, SIGNALS = "shifts", "signals"
NAME_DIGITS: Final = 32  # of a sha256: enough that no two logs share a name
SETTINGS_DIGITS: Final = 16
DATE_CHARACTERS: Final = 10  # of a moment in ISO 8601


@dataclass(frozen=True, slots=True, kw_only=True)
class RemovedParts:
    """What was removed from a lake."""

    lake: str  # its address
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
    lake: str = field(default="", compare=False)  # its address
    text: str = field(default="", compare=False)  # what there is, for people


def parts_of(lake: Place, vehicle: str = "", *, with_unfinished: bool = False) -> Iterator[Held]:
    """Yield all parts of a lake, or of a vehicle, if asked for with those that a killed process has not finished."""
    for kind in (SHIFTS, SIGNALS):
        for part in lake.held(kind, with_unfinished=with_unfinished).values():
            if not vehicle or f"vehicle={vehicle}" in part.name.split("/"):
                yield part


def forget(lake: Place, vehicle: str) -> RemovedParts:
    """Take one vehicle out of a lake: its parts, whoever made them, its rows, its folders; then look again.

    Logs that are not in the lake, and copies that others made of it, stay.

    Raises StoreError if anything of the vehicle is still there afterwards.
    """
    manifest = Manifest(lake)
    rows = [row for row in manifest.rows if row.vehicle == vehicle]
    parts = {part.name: part for part in parts_of(lake, vehicle, with_unfinished=True)}
    lake.remove(parts)
    manifest.forget(vehicle)
    again = (row.source for row in Manifest(lake).rows if row.vehicle == vehicle)
    left = [*(part.name for part in parts_of(lake, vehicle, with_unfinished=True)), *again]
    if left:
        raise StoreError(f"{len(left)} things of {vehicle} are still in {lake.address}, the first: {left[0]}")
    return RemovedParts(
        lake=lake.address,
        vehicle=vehicle,
        parts=tuple(parts),
        part_bytes=sum(part.size_bytes for part in parts.values()),
        rows=len(rows),
        shifts=sum(row.shifts for row in rows),
    )


def disagreement(lake: Place) -> Disagreement:
    """Return in what manifest and parts disagree."""
    there, rows = {part.name for part in parts_of(lake)}, Manifest(lake).rows
    known = {part for row in rows for part in row.parts}
    shifts: dict[tuple[str, str], set[str]] = defaultdict(set)
    for row in rows:
        if row.outcome == DONE:
            shifts[row.content, row.vehicle].add(row.settings)
    failed, shift_count = sum(row.outcome == FAILED for row in rows), sum(row.shifts for row in rows)
    what = f"{shift_count} shifts of {len({row.vehicle for row in rows})} vehicles in {len(there)} parts"
    return Disagreement(
        missing=tuple(sorted(known - there)),
        unknown=tuple(sorted(there - known)),
        twice=tuple(sorted({content for (content, _), settings in shifts.items() if len(settings) > 1})),
        lake=lake.address,
        text=f"{len(rows)} logs, {failed} of them not analysed, {what}",
    )


def part_name(kind: str, date: str, vehicle: str, content: str, settings: str) -> str:
    """Return the name of a part: it says what is in it, so whoever makes it again makes the same file."""
    name = f"{content[:NAME_DIGITS]}-{settings[:SETTINGS_DIGITS]}.parquet"
    return f"{kind}/date={date}/vehicle={vehicle}/{name}"


def write_shifts(path: Path, content: str, shifts: Iterable[JsonObject], *, is_complete: bool) -> None:
    """Write shifts of the log of a digest as one part.

    Their ``path`` is the digest: a part depends on its content alone, and the manifest tells where that lies. Rows are
    in order of time, so that a reader who looks for a time or a vehicle skips most row groups by their statistics.
    """
    rows = ({"path": f"sha256:{content}", "complete": is_complete, **flattened(shift)} for shift in shifts)
    write_parquet(path, sorted(rows, key=lambda row: str(row["start_utc"])))


def signal_plan(plan: Plan, patterns: str) -> Plan:
    """Return the plan for the signals that are asked for, separated by commas; raises ConfigError if there are none."""
    wanted = [pattern.strip() for pattern in patterns.split(",") if pattern.strip()]
    try:
        return plan.part(wanted, None, None)
    except DefinitionError as exc:
        raise ConfigError(str(exc)) from exc


def first_date(path: Path, log_columns: str) -> str:
    """Return the day, in UTC, on which a log begins; raises SourceError if it cannot be read or holds no frame."""
    with closing(read_log(path, columns=log_columns)) as reader:
        return utc_from_bus_ns(int(next(reader).t_ns[0]))[:DATE_CHARACTERS]
