"""The files of a lake: their names, by date and vehicle, and their rows."""

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Final

from canlog.errors import DefinitionError, SourceError
from canlog.logs import read_log
from canlog.parquet_file import ParquetTable
from canlog.tables.decoding import Plan, decode_logs
from canlog.tables.outputs import TableFormat
from diag_service.batch.tables import BATCH_ROWS, columns, flattened
from diag_service.diagnosis.records import utc_from_bus_ns
from diag_service.errors import ConfigError, StoreError
from diag_service.lake.manifest import DONE, Manifest
from diag_service.lake.places import Held, Place
from fleet_contract import JsonObject

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


def shift_columns() -> dict[str, str]:
    """Return the columns of the parts of shifts and their types: those of results of folders, ``path`` the source."""
    return columns()


def write_shifts(path: Path, source: str, shifts: Sequence[tuple[JsonObject, bool]]) -> None:
    """Write shifts, each with whether its log was complete, as one part.

    Rows are in order of time, so that a reader who looks for a time or a vehicle skips most row groups by their
    statistics.
    """
    rows = sorted(
        ({"path": source, "complete": is_complete, **flattened(shift)} for shift, is_complete in shifts),
        key=lambda row: str(row["start_utc"]),
    )
    with path.open("wb") as stream, ParquetTable(stream, shift_columns()) as table:
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
