"""Logs from Python: their signals, the traffic that they hold, and a profile proposed from them."""

from collections.abc import Iterable, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Message

import canlog
from canlog.arrays import FloatArray
from canlog.database.addressing import NOBODY, address_book, find_slot, message_address, overwritten
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.e2e.message_contract import message_contract
from canlog.e2e.protection_check import FrameReason, LinkMonitor
from canlog.errors import InputLeftError
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs import LogReader, read_log
from canlog.logs.reading import Watch
from canlog.traffic import DEFAULT_BITRATE, NS_PER_S, TrafficMeter, TrafficReport
from clutch_results.records import dump
from diag_service.api.choices import AnyPath, AnyPaths, optional_path, path_list
from diag_service.console import collected_notices
from diag_service.errors import ConfigError
from diag_service.mapping.interpretation import open_database
from diag_service.mapping.learning import proposed_profile
from diag_service.service.stopping import Trigger

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
        self._of_id = {column_id(one.name) | EXTENDED_FLAG: ColumnValues(one.name, one.unit) for one in columns}

    @property
    def names(self) -> dict[int, str]:
        """The names of the columns by their identifiers, with the flag of an extended one."""
        return {can_id: one.name for can_id, one in self._of_id.items()}

    def add(self, batch: FrameBatch) -> None:
        values = np.ascontiguousarray(batch.data[:, :8]).view("<f8").ravel()
        order = np.argsort(batch.can_id, kind="stable")
        found, starts = np.unique(batch.can_id[order], return_index=True)
        for can_id, rows in zip(found.tolist(), np.split(order, starts[1:]), strict=True):
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
    values: TableValues | None = None  # of a table of signals

    def to_json(self) -> str:
        """Return what ``--json`` prints: one JSON object, on one line."""
        counts = self.reader.counts
        table = asdict(self.traffic)
        for one in table["ids"]:
            one["message"] = self.names.get(one["can_id"])
            if self.values is not None:
                column = self.values.of(one["can_id"])
                one.update({name: getattr(column, name) for name in ("unit", "changes", "lowest", "highest", "step")})
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


def read(
    paths: AnyPaths,
    dbc: AnyPath | None = None,
    *,
    is_strict: bool = False,
    columns: str = "",
) -> "canlog.Log":
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
    paths: AnyPaths,
    output: AnyPath,
    dbc: AnyPath | None = None,
    choice: "canlog.TableChoice | None" = None,
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
    path: AnyPath,
    dbc: AnyPath | None = None,
    *,
    bitrate: int = DEFAULT_BITRATE,
    columns: str = "",
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
    with collected_notices():
        messages = open_database(optional_path(dbc), [Path(path)]).messages
        return inspect_log(Path(path), messages, bitrate, Trigger(), columns=columns)


def propose_profile(path: AnyPath, dbc: AnyPath | None = None, *, columns: str = "") -> str:
    """Return a profile for a vehicle as TOML text, proposed from a log and its database: ``diag-service signals``.

    Raises
    ------
    SourceError, DefinitionError
        If the log or the database cannot be read.
    """
    with collected_notices():
        return proposed_profile(Path(path), optional_path(dbc), columns=columns)


def inspect_log(
    path: Path,
    messages: Sequence[Message],
    bitrate: int,
    stop: Trigger,
    watch: Watch | None = None,
    columns: str = "",
) -> Inspection:
    """Read a log once and return what it holds.

    Raises SourceError if it cannot be read, ConfigError if the bit rate is not above zero.
    """
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
    counts, missing = monitor.counts, monitor.missing
    return Inspection(
        reader=reader,
        traffic=traffic,
        names=_names(messages, {one.can_id for one in traffic.ids}) if values is None else values.names,
        links={
            message.name: LinkErrors(
                good=int(row[FrameReason.OK]),
                errors={one.name.lower(): int(row[one]) for one in FrameReason if one != FrameReason.OK and row[one]},
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
    kept = [slot for slot in range(len(messages)) if slot not in later]
    book = address_book([addresses[slot] for slot in kept])
    slots = {can_id: find_slot(book, can_id) for can_id in can_ids if not can_id & (REMOTE_FLAG | ERROR_FLAG)}
    return {can_id: messages[kept[slot]].name for can_id, slot in slots.items() if slot != NOBODY}
