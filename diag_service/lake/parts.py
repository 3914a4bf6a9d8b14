"""The files of a lake: parts by date and vehicle, and a manifest of what was made of which log.

Rows of the manifest are only ever added, and now and then put together; many are shared out to partitions by vehicle,
so that a lake of millions of logs is read in parts. A file of rows has a generation in its name, and of a log the row
of the latest generation holds. So nothing is written over, whoever was killed, and a log that two files tell of is
there once.
"""

import hashlib
import io
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cache
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final
from zlib import crc32

from canlog.column_files import TIME_TYPE, ParquetTable, load_pyarrow
from canlog.errors import DefinitionError, SourceError
from canlog.logs import read_log
from canlog.tables.decoding import Plan
from diag_service.batch.tables import BATCH_ROWS, flattened, write_parquet
from diag_service.diagnosis.records import iso_utc, utc_from_bus_ns
from diag_service.errors import ConfigError, StoreError
from diag_service.lake.places import Held, Place
from fleet_contract import JsonObject

FOLDER: Final = "manifest"
DONE, FAILED = "done", "failed"
FULL_ROWS: Final = 50_000  # of the manifest that are of any vehicle; more are shared out
PARTITIONS: Final = 64  # of a manifest: a year of 10,000 vehicles has 57,000 rows in each
GROUP_ROWS: Final = 128  # with all that logs said of themselves, held for each partition while rows are shared out
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
    """The rows of a lake, or of the partitions that some vehicles are in, as they were and as they became since.

    What logs said of themselves, by far the most of a row, stays in the files: ``account`` is empty here. Rows of many
    vehicles are added in files of their own; when those are full, their rows go into partitions by vehicle, which stay
    as they are. A file that is written anew keeps its generation.

    Raises StoreError if a file of it is none.
    """

    def __init__(self, place: Place, partitions: Collection[str] | None = None, full_rows: int = FULL_ROWS) -> None:
        self._place = place
        self._full_rows = full_rows
        self._rows: dict[str, LogRow] = {}
        self._file_of: dict[str, str] = {}  # of the row that holds
        self._left: dict[str, set[str]] = {}  # logs that are of a vehicle of another partition now, by file
        names = _files_of(place)
        self._generation = max(map(_generation_of, names), default=0)
        self._files = [name for name in names if partitions is None or _partition_in(name) in {"", *partitions}]
        narrow = [one for one in manifest_columns() if one != "account"]
        for name in self._files:
            for rows in _parsed(place, name, narrow, None if _partition_in(name) else partitions):
                self._take(rows, name)

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
            self._generation += 1
            (name,) = self._write([rows], lambda _row: "", self._generation)
            self._files.append(name)
            self._take(rows, name)

    def forget(self, vehicle: str) -> None:
        """Write the files anew in which a vehicle is, without it."""
        for name in self._files:
            if any(vehicle in batch["vehicle"].to_pylist() for batch in _batches(self._place, name, ["vehicle"])):
                self._write_anew(name, vehicle=vehicle)

    def put_together(self) -> None:
        """Write one file in place of those that were added, or, once they are full, one in each partition."""
        for name, sources in self._left.items():
            self._write_anew(name, sources=sources)
        self._left = {}
        added = [name for name in _files_of(self._place) if not _partition_in(name)]
        holding = {
            source: name
            for name in added
            for batch in _batches(self._place, name, ["source"])
            for source in batch["source"].to_pylist()
        }
        is_full = len(holding) >= self._full_rows
        if len(added) <= 1 and not is_full:
            return
        self._generation += 1
        kept = (
            [row for row in rows if holding[row.source] == name]
            for name in added
            for rows in _parsed(self._place, name, list(manifest_columns()))
        )
        self._write(kept, lambda row: partition_of(row.vehicle) if is_full else "", self._generation)
        self._place.remove(added)

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
        for row in rows:
            before = self._file_of.get(row.source, "")
            if _partition_in(before) not in {"", partition_of(row.vehicle)}:
                self._left.setdefault(before, set()).add(row.source)
            self._rows[row.source], self._file_of[row.source] = replace(row, account="") if row.account else row, name

    def _write_anew(self, name: str, *, vehicle: str = "", sources: Collection[str] = ()) -> None:
        """Write a file anew without the rows of a vehicle and of some logs."""
        whole = _parsed(self._place, name, list(manifest_columns()))
        kept = ([row for row in rows if row.vehicle != vehicle and row.source not in sources] for rows in whole)
        written = self._write(kept, lambda _row: _partition_in(name), _generation_of(name))
        self._place.remove({name}.difference(written))

    def _write(
        self, groups: Iterable[Sequence[LogRow]], partition: Callable[[LogRow], str], generation: int
    ) -> list[str]:
        """Write rows as a file in each of their partitions; return the names."""
        names = []
        with TemporaryDirectory(prefix="clutchdiag-") as folder, ExitStack() as stack:
            tables: dict[str, ParquetTable] = {}
            waiting: dict[str, list[LogRow]] = defaultdict(list)

            def write(where: str) -> None:
                if where not in tables:
                    stream = stack.enter_context((Path(folder) / (where or "rows")).open("wb"))
                    tables[where] = stack.enter_context(ParquetTable(stream, manifest_columns()))
                rows = waiting.pop(where)
                told = ({name: getattr(row, name) for name in manifest_columns()} for row in rows)
                tables[where].write_rows([{**row, "parts": _SEPARATOR.join(row["parts"])} for row in told])

            for row in chain.from_iterable(groups):
                waiting[where := partition(row)].append(row)
                if len(waiting[where]) >= GROUP_ROWS:
                    write(where)
            for where in list(waiting):
                write(where)
            stack.close()
            for where in tables:
                path = Path(folder) / (where or "rows")
                name = f"{generation:010}-{content_digest(path)[:16]}.parquet"
                names.append("/".join(filter(None, (FOLDER, where, name))))
                self._place.put(names[-1], path)
        return names


@cache
def manifest_columns() -> dict[str, str]:
    """Return the columns of the manifest and their types; ``parts`` are names, separated by semicolons."""
    return {field.name: _TYPES.get(field.name, "string") for field in fields(LogRow)}


def partition_of(vehicle: str) -> str:
    """Return the folder of the manifest in which the rows of a vehicle are once they are many."""
    return f"{crc32(vehicle.encode(errors='surrogateescape')) % PARTITIONS:02}"


def copies(rows: Iterable[LogRow], made: Iterable[LogRow]) -> list[LogRow]:
    """Return rows of logs with the content of one made anew, in its state: nobody finds one that was moved again."""
    anew = {(row.content, row.vehicle): row for row in made if row.outcome == DONE}
    sources, found = {row.source for row in made}, list[LogRow]()
    for old in rows:
        new = anew.get((old.content, old.vehicle))
        if new is None or old.outcome != DONE or old.source in sources or old.settings == new.settings:
            continue
        parts = (part for row, kind in ((new, SHIFTS), (old, SIGNALS)) for part in row.parts if part.startswith(kind))
        found.append(replace(new, source=old.source, key=old.key, signals=old.signals, parts=tuple(parts)))
    return found


def mend(place: Place, missing: Collection[str]) -> None:
    """Let rows of one content be in the state that was made last, and the next run make anew what is missing."""
    changed, absent = dict[str, LogRow](), set(missing)
    for rows in partitions(place):
        done = sorted((row for row in rows if row.outcome == DONE), key=lambda row: row.made_at)
        last = {(row.content, row.vehicle): row for row in done}
        lost = (replace(row, key="") for row in rows if not absent.isdisjoint(row.parts))
        changed |= {row.source: row for row in (*copies(rows, last.values()), *lost)}
    Manifest(place, ()).add([replace(row, account='{"logs":[]}') for row in changed.values()])


def partitions(place: Place) -> Iterator[tuple[LogRow, ...]]:
    """Yield the rows of a lake that hold, a partition at a time; two of one vehicle are in the same one."""
    names = _files_of(place)
    if not any(map(_partition_in, names)):
        yield Manifest(place).rows
        return
    for number in range(PARTITIONS):
        yield Manifest(place, partitions=[f"{number:02}"]).rows


def strayed(place: Place, vehicles: Mapping[str, str]) -> dict[str, set[str]]:
    """Return of which other vehicles logs were before, by the one that they are of now; given by source."""
    found: dict[str, set[str]] = defaultdict(set)
    for name in filter(_partition_in, _files_of(place)):
        for batch in _batches(place, name, ["source", "vehicle"]):
            for source, before in zip(batch["source"].to_pylist(), batch["vehicle"].to_pylist(), strict=True):
                if (own := vehicles.get(source, before)) != before:
                    found[own].add(before)
    return found


def _files_of(place: Place) -> list[str]:
    """Return the files of a manifest, the oldest first."""
    return sorted(place.held(FOLDER), key=_generation_of)


def _partition_in(name: str) -> str:
    """Return the partition that a file of the manifest is of; empty: of any."""
    return name.removeprefix(f"{FOLDER}/").rpartition("/")[0]


def _generation_of(name: str) -> int:
    number = name.rpartition("/")[2].partition("-")[0]
    if not number.isdecimal():
        raise StoreError(f"{name} is not a file of a manifest")
    return int(number)


def _parsed(place: Place, name: str, wanted: list[str], among: Collection[str] | None = None) -> Iterator[list[LogRow]]:
    """Yield the rows of a file, of some partitions, some at a time; a column that is not wanted is empty."""
    arrow = load_pyarrow()
    with _understood(name):
        for batch in _batches(place, name, wanted):
            if among is None:
                yield [_row(row) for row in batch.to_pylist()]
            else:
                is_of = [partition_of(one) in among for one in batch["vehicle"].to_pylist()]
                yield [_row(row) for row in batch.filter(arrow.array(is_of, arrow.bool_())).to_pylist()]


def _batches(place: Place, name: str, wanted: list[str]) -> Iterator[Any]:
    """Yield columns of a file of the manifest, some rows at a time."""
    with _understood(name):
        # By this thread alone: threads of Arrow that outlive a short program abort it.
        file = load_pyarrow().parquet.ParquetFile(place.path(name) or io.BytesIO(place.read(name)))
        yield from file.iter_batches(BATCH_ROWS, columns=wanted, use_threads=False)


@contextmanager
def _understood(name: str) -> Iterator[None]:
    try:
        yield
    except (load_pyarrow().ArrowException, KeyError, TypeError, OSError) as exc:
        raise StoreError(f"{name} is not a file of a manifest: {exc}") from exc


def _row(row: dict[str, Any]) -> LogRow:
    same = {name: sys.intern(row[name]) for name in ("vehicle", "settings", "signals", "algorithm_version", "outcome")}
    parts = tuple(filter(None, row["parts"].split(_SEPARATOR)))
    return LogRow(**{"account": "", **row, **same, "parts": parts, "made_at": iso_utc(row["made_at"])})


SHIFTS, SIGNALS = "shifts", "signals"
NAME_DIGITS: Final = 32  # of a sha256: enough that no two logs share a name
SETTINGS_DIGITS: Final = 16
DATE_CHARACTERS: Final = 10  # of a moment in ISO 8601


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
    told: str = field(default="", compare=False)  # what there is


def parts_of(lake: Place, vehicle: str = "*", *, with_unfinished: bool = False) -> Iterator[Held]:
    """Yield all parts of a lake, or of a vehicle, if asked for with those that a killed process has not finished."""
    for kind in (SHIFTS, SIGNALS):
        for day in lake.folders(kind):
            own = day if vehicle == "*" else f"{day}/{_folder(vehicle)}"
            yield from lake.held(own, with_unfinished=with_unfinished).values()


def forget(lake: Place, vehicle: str) -> Forgotten:
    """Take one vehicle out of a lake: its parts, whoever made them, its rows, its folders; then look again.

    Logs that are not in the lake, and copies that others made of it, stay.

    Raises StoreError if anything of the vehicle is still there afterwards.
    """
    manifest = Manifest(lake, [partition_of(vehicle)])
    rows = [row for row in manifest.rows if row.vehicle == vehicle]
    found = {part.name: part for part in parts_of(lake, vehicle, with_unfinished=True)}
    lake.remove(found)
    manifest.forget(vehicle)
    folders = [name for kind in (SHIFTS, SIGNALS) for name in lake.remove_folders(f"{kind}/*/{_folder(vehicle)}")]
    again = (row.source for row in Manifest(lake, [partition_of(vehicle)]).rows if row.vehicle == vehicle)
    left = [*(part.name for part in parts_of(lake, vehicle, with_unfinished=True)), *folders, *again]
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
    unknown = {part.name for part in parts_of(lake)}
    found, part_count = Counter[str](), len(unknown)
    missing, twice = set[str](), set[str]()
    for rows in partitions(lake):
        known = {part for row in rows for part in row.parts}
        missing |= known - unknown
        unknown -= known
        shifts: dict[tuple[str, str], set[str]] = defaultdict(set)
        for row in rows:
            found.update({row.outcome: 1, "shifts": row.shifts})
            if row.outcome == DONE:
                shifts[row.content, row.vehicle].add(row.settings)
        twice |= {content for (content, _), settings in shifts.items() if len(settings) > 1}
        found["vehicles"] += len({row.vehicle for row in rows})
    told = (
        f"{found[DONE] + found[FAILED]} logs, {found[FAILED]} of them not analysed, {found['shifts']} shifts of "
        f"{found['vehicles']} vehicles in {part_count} parts"
    )
    return Disagreement(
        missing=tuple(sorted(missing)), unknown=tuple(sorted(unknown)), twice=tuple(sorted(twice)), told=told
    )


def _folder(vehicle: str) -> str:
    return f"vehicle={vehicle}"


def content_digest(path: Path) -> str:
    """Return the sha256 of a file; raises SourceError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as exc:
        raise SourceError(f"cannot read {path}: {exc.strerror or exc}") from exc


def part_name(kind: str, date: str, vehicle: str, content: str, settings: str) -> str:
    """Return the name of a part: it says what is in it, so whoever makes it again makes the same file."""
    name = f"{content[:NAME_DIGITS]}-{settings[:SETTINGS_DIGITS]}.parquet"
    return f"{kind}/date={date}/vehicle={vehicle}/{name}"


def by_date(shifts: Sequence[JsonObject]) -> Mapping[str, list[JsonObject]]:
    """Return shifts by the day on which they began."""
    days: dict[str, list[JsonObject]] = defaultdict(list)
    for shift in shifts:
        days[str(shift["start_utc"])[:DATE_CHARACTERS]].append(shift)
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
    write_parquet(path, rows)


def signal_plan(plan: Plan, patterns: str) -> Plan:
    """Return the plan for the signals that are asked for, separated by commas; raises ConfigError if there are none."""
    wanted = [one.strip() for one in patterns.split(",") if one.strip()]
    try:
        return plan.part(wanted, None, None)
    except DefinitionError as exc:
        raise ConfigError(str(exc)) from exc


def first_date(path: Path, log_columns: str) -> str:
    """Return the day, in UTC, on which a log begins; raises SourceError if it cannot be read or holds no frame."""
    with closing(read_log(path, columns=log_columns)) as reader:
        return utc_from_bus_ns(int(next(reader).t_ns[0]))[:DATE_CHARACTERS]
