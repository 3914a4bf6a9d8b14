"""Logs from Python: their signals, the traffic that they hold, and a profile proposed from them."""

from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Message

import canlog
from canlog.arrays import FloatArray
from canlog.database.addressing import NOBODY, address_book, find_slots, message_address, overwritten, why_wrong
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.e2e.message_contract import message_contract
from canlog.e2e.protection_check import FrameReason, LinkMonitor
from canlog.errors import InputLeftError, SourceError
from canlog.files import is_folder
from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.logs import STANDARD_INPUT, LogReader, read_log
from canlog.logs.reading import Watch
from canlog.logs.streams import never
from canlog.traffic import DEFAULT_BITRATE, NS_PER_S, TrafficMeter, TrafficReport
from clutch_results.records import dump
from diag_service.api.choices import AnyPath, AnyPaths, optional_path, path_list
from diag_service.batch.drives import LeftOut, RecognisedLog, split_folder
from diag_service.console import SILENT, ReadingLine, collected_notices
from diag_service.errors import ConfigError
from diag_service.mapping.interpretation import open_database
from diag_service.mapping.learning import proposed_profile
from diag_service.settings.options import InspectOptions, messages_of
from diag_service.stopping import Controls, Trigger

INSPECT_SCHEMA: Final = "clutchdiag/inspect/v1"
MOST_DISTINCT: Final = 4096  # values of a column that are kept to find its step


@dataclass(slots=True)
class ColumnValues:
    """The values of one column.

    ``step`` is the smallest difference between two of its values, 0 for a constant; of a column with very many values
    it is that of the first ones. A value that equals the one before it was perhaps not measured anew.
    """

    name: str
    unit: str
    count: int = 0
    changes: int = 0
    lowest: float = np.inf
    highest: float = -np.inf
    step: float = 0.0
    _distinct: FloatArray | None = None
    _last: float = np.nan

    def add(self, values: FloatArray) -> None:
        """Count more values, oldest first."""
        self.count += len(values)
        self.lowest, self.highest = min(self.lowest, float(values.min())), max(self.highest, float(values.max()))
        self.changes += int(np.count_nonzero(np.diff(values, prepend=self._last)))
        self.changes -= int(np.isnan(self._last))  # the first value is no change
        self._last = float(values[-1])
        known = values if self._distinct is None else np.concatenate([self._distinct, values])
        self._distinct = np.unique(known)[:MOST_DISTINCT]
        self.step = float(np.diff(self._distinct).min(initial=np.inf)) if len(self._distinct) > 1 else 0.0


class TableValues:
    """The values of all columns of a table."""

    def __init__(self, columns: Iterable[SignalColumn]) -> None:
        self._of_id = {
            column_id(column.name) | EXTENDED_FLAG: ColumnValues(column.name, column.unit) for column in columns
        }

    @property
    def names(self) -> dict[int, str]:
        """The names of the columns by their identifiers, with the flag of an extended one."""
        return {can_id: column.name for can_id, column in self._of_id.items()}

    def add(self, batch: FrameBatch) -> None:
        values = np.ascontiguousarray(batch.data[:, :8]).view("<f8").ravel()
        order = np.argsort(batch.can_id, kind="stable")
        can_ids, starts = np.unique(batch.can_id[order], return_index=True)
        for can_id, rows in zip(can_ids.tolist(), np.split(order, starts[1:]), strict=True):
            if can_id in self._of_id:
                self._of_id[can_id].add(values[rows])

    def of(self, can_id: int) -> ColumnValues:
        return self._of_id[can_id]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkErrors:
    """What the protection of one message says of its frames."""

    good: int
    errors: dict[str, int]
    missing: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """One log."""

    reader: LogReader
    traffic: TrafficReport
    names: dict[int, str]  # identifier with flags -> message
    links: dict[str, LinkErrors]  # of protected messages that were seen
    is_whole: bool
    why_wrong: str  # the database, as far as that is likely
    values: TableValues | None = None  # of a table of signals

    def to_json(self) -> str:
        """Return what ``--json`` prints: one JSON object, on one line."""
        counts = self.reader.counts
        table = asdict(self.traffic)
        for entry in table["ids"]:
            entry["message"] = self.names.get(entry["can_id"])
            if self.values is not None:
                column = self.values.of(entry["can_id"])
                entry.update({name: getattr(column, name) for name in ("unit", "changes", "lowest", "highest", "step")})
        record = {
            "schema": INSPECT_SCHEMA,
            "path": str(self.reader.path),
            "complete": self.is_whole and not counts.truncated,
            "stopped_early": not self.is_whole,
            "format": self.reader.format.value,
            "evidence": self.reader.evidence,
            "unreadable": {reason.value: count for reason, count in counts.rejected.items()},
            "first_unreadable": counts.first_rejected,
            "truncated": counts.truncated,
            "notes": list(counts.notes),
            **table,
            "protection": {name: asdict(link) for name, link in self.links.items()},
        }
        return dump(record)


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderContent:
    """Which files of a folder, and below, are logs."""

    path: Path
    logs: tuple[RecognisedLog, ...]
    others: tuple[LeftOut, ...]


def read(paths: AnyPaths, dbc: AnyPath | None = None, *, is_strict: bool = False, columns: str = "") -> "canlog.Log":
    """Return the frames of logs and their signals as arrays or tables, as ``diag-service decode`` writes them.

    Parameters
    ----------
    paths
        One log, or several, whose frames are put in the order of time.
    dbc
        Message database; without one the shipped one.
    is_strict, columns
        As of ``analyze``.

    Returns
    -------
    canlog.Log
        ``.signals()`` for arrays by ``Message.Signal``, ``.to_pandas()``, ``.to_polars()``, ``.to_arrow()``;
        ``.losses`` says what of the log is not in them. Values are in the units of the database.

    Raises
    ------
    SourceError, DefinitionError
        If a log or the database cannot be read.
    """
    with collected_notices():
        database = open_database(optional_path(dbc), path_list(paths))
        return canlog.read(path_list(paths), database, is_strict=is_strict, columns=columns)


def decode(
    paths: AnyPaths, output: AnyPath, dbc: AnyPath | None = None, choice: "canlog.TableChoice | None" = None
) -> list[str]:
    """Write the signals of logs as a table of any size, as ``diag-service decode`` does.

    Parameters
    ----------
    output
        The table, which appears when it is complete; one that is there is replaced.
    choice
        What is written, and how: every signal in a row per frame, unless it says otherwise.
    paths, dbc
        As of ``read``.

    Returns
    -------
    list of str
        What of the logs is not in the table though it should be, in words.

    Raises
    ------
    SourceError, DefinitionError, OutputError, ExtraMissingError
        If a log or the database cannot be read, the table cannot be written, or a library for it is missing.
    """
    with collected_notices():
        database = open_database(optional_path(dbc), path_list(paths))
        return canlog.write_table(path_list(paths), database, Path(output), choice or canlog.TableChoice())


def inspect(
    path: AnyPath, dbc: AnyPath | None = None, *, bitrate: int = DEFAULT_BITRATE, columns: str = ""
) -> Inspection:
    """Return what traffic a log holds, as ``diag-service inspect`` shows it.

    Parameters
    ----------
    bitrate
        That the bus load is told for [bit/s].
    path, dbc, columns
        As of ``analyze``.

    Raises
    ------
    SourceError, DefinitionError, ConfigError
        If the log or the database cannot be read, or the bit rate is not above zero.
    """
    options = InspectOptions(logs=(Path(path),), dbc=optional_path(dbc), bitrate=bitrate, columns=columns)
    with collected_notices():
        return _inspected(options.logs[0], messages_of(options, never), options, Trigger())


def propose_profile(path: AnyPath, dbc: AnyPath | None = None, *, columns: str = "") -> str:
    """Return a profile for a vehicle as TOML text, proposed from a log and its database: ``diag-service signals``.

    Raises
    ------
    SourceError, DefinitionError
        If the log or the database cannot be read.
    """
    with collected_notices():
        return profile_for(Path(path), optional_path(dbc), columns, Controls())


def profile_for(log: Path, dbc: Path | None, columns: str, controls: Controls, line: ReadingLine = SILENT) -> str:
    """Return the profile that is proposed for a log; raises what ``propose_profile`` does, and StoppedError."""
    return proposed_profile(log, dbc, lambda: controls.stop.is_set, watch=line.watch, columns=columns)


def inspect_logs(
    options: InspectOptions, controls: Controls, line: ReadingLine = SILENT
) -> Iterator[Inspection | FolderContent | LeftOut]:
    """Yield what logs hold, of each folder first which files are logs, and why one cannot be read after all.

    Raises ConfigError if a folder holds no log.
    """
    messages = messages_of(options, lambda: controls.stop.is_set)
    for path in options.logs:
        if path == STANDARD_INPUT or not is_folder(path):
            yield _inspected(path, messages, options, controls.stop, line.watch)
            continue
        logs, others = split_folder(path, options.columns)
        yield FolderContent(path=path, logs=tuple(logs), others=tuple(others))
        if not logs:
            raise ConfigError(f"{path} holds no log that can be read")
        for log in logs:
            try:
                inspection = _inspected(log.path, messages, options, controls.stop, line.watch)
            except SourceError as exc:
                yield LeftOut(path=log.path, reason=str(exc).removeprefix(f"{log.path}: "))
            else:
                yield inspection


def _inspected(
    path: Path, messages: Sequence[Message], options: InspectOptions, stop: Trigger, watch: Watch | None = None
) -> Inspection:
    """Read a log once and return what it holds.

    Raises SourceError if it cannot be read, ConfigError if the bit rate is not above zero.
    """
    bitrate, columns = options.bitrate, options.columns
    if bitrate <= 0:
        raise ConfigError(f"the bit rate must be > 0, got {bitrate}")
    reader = read_log(path, is_stopped=lambda: stop.is_set, watch=watch, columns=columns)
    meter = TrafficMeter(bitrate)
    protected = [message for message in messages if message_contract(message).data_id is not None]
    monitor = LinkMonitor(protected)
    values = TableValues(reader.columns) if reader.columns else None
    last_ns: int | None = None
    is_whole = True
    try:
        for batch in reader:
            if stop.is_set:
                is_whole = False
                break
            meter.add(batch, reader.longest_step_ns)
            if values is not None:
                values.add(batch)
            steps_ns = np.diff(batch.t_ns, prepend=batch.t_ns[0] if last_ns is None else last_ns)
            jumps = np.flatnonzero((steps_ns < 0) | (steps_ns > NS_PER_S)).tolist()
            for number, (first, end) in enumerate(pairwise([0, *jumps, len(batch)])):
                if number:
                    monitor.reset()
                monitor.check(batch[first:end])
            last_ns = int(batch.t_ns[-1])
    except InputLeftError:
        is_whole = False
    finally:
        reader.close()
    traffic = meter.report()
    can_ids = {reason.can_id for reason in traffic.ids}
    names = _names(messages, can_ids) if values is None else values.names
    counts, missing = monitor.counts, monitor.missing
    return Inspection(
        reader=reader,
        traffic=traffic,
        names=names,
        why_wrong=why_wrong(len(can_ids & names.keys()), len(can_ids), len(set(names.values())), len(messages)),
        links={
            message.name: LinkErrors(
                good=int(row[FrameReason.OK]),
                errors={
                    reason.name.lower(): int(row[reason])
                    for reason in FrameReason
                    if reason != FrameReason.OK and row[reason]
                },
                missing=int(lost),
            )
            for message, row, lost in zip(protected, counts[:-1], missing, strict=True)
            if row.sum()
        },
        is_whole=is_whole,
        values=values,
    )


def _names(messages: Sequence[Message], can_ids: AbstractSet[int]) -> dict[int, str]:
    """Return the names of the messages that identifiers, with their flags, belong to; of several the last one's."""
    addresses = [message_address(message) for message in messages]
    later = overwritten(addresses)
    usable = [slot for slot in range(len(messages)) if slot not in later]
    book = address_book([addresses[slot] for slot in usable])
    slots = find_slots(book, np.array([*can_ids], np.uint32)).tolist()
    named = zip(can_ids, slots, strict=True)
    return {can_id: messages[usable[slot]].name for can_id, slot in named if slot != NOBODY}
