"""``diag-service inspect`` and ``signals``: what a log holds, whatever it means, and a profile proposed from it."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from cantools.database.can import Message

from canlog.arrays import FloatArray
from canlog.database.addressing import NOBODY, address_book, find_slot, message_address, overwritten, why_wrong
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.e2e.message_contract import message_contract
from canlog.e2e.protection_check import FrameReason, LinkMonitor
from canlog.errors import InputLeftError, SourceError
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs import STANDARD_INPUT, LogReader, read_log
from canlog.logs.log_counts import assumed_texts, lost_texts
from canlog.logs.reading import Watch
from canlog.traffic import MAX_IDS, NS_PER_S, IdTraffic, TrafficMeter, TrafficReport
from clutch_results.records import dump, utc_from_bus_ns
from clutchdiag_io.people import SHORT_PLUS_MINUS, STDS, digits
from diag_service.batch.drives import LeftOut, left_out_record, sorted_out
from diag_service.console import PeopleConsole, ReadingLine
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.databases import asked_database
from diag_service.mapping.survey import proposed_profile
from diag_service.service.stopping import Controls, Trigger

MOST_DISTINCT = 4096  # values of a column that are kept to find its step


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


SCHEMA = "clutchdiag/inspect/v1"
MS_PER_S = 1e3
_COLUMNS = "{:>3} {:<8} {} {:>8} {:>5} {:>8} {:>9} {:>9} {:>5} {:>9}"
_VALUE_COLUMNS = "{} {:>8} {:>8} {:>8} {:>9} {:>9} {:>8} {:>9} {:>10} {:>10}"
_VALUE_HEAD = ("unit", "values", "rate Hz", "period ms", SHORT_PLUS_MINUS, "changes", "step", "lowest", "highest")
_HEAD = ("frames", "bytes", "rate Hz", "period ms", SHORT_PLUS_MINUS, "gaps", "longest s")


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
            "schema": SCHEMA,
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


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Inspect one log after the other; raises StoppedError if that was stopped."""
    messages = asked_database(options, lambda: controls.stop.is_set).messages
    console = PeopleConsole()
    columns = options.columns or ""
    for path, is_found in _files(options, columns, console):
        try:
            with ReadingLine() as line:
                inspection = inspect_log(path, messages, options.bitrate, controls.stop, line.watch, columns)
        except SourceError as exc:
            if not is_found:
                raise
            _show_left_out(LeftOut(path=path, reason=str(exc).removeprefix(f"{path}: ")), options, console)
            continue
        if options.json:
            sys.stdout.write(inspection.to_json() + "\n")
        else:
            _show(inspection, options.bitrate, console)
            if options.dbc is not None and (why := _why_wrong(inspection, messages)):
                console.print(why)
        if not inspection.is_whole:
            raise StoppedError("stopped early: the last table covers only a part of the log")


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


def _files(options: SimpleNamespace, columns: str, console: PeopleConsole) -> Iterator[tuple[Path, bool]]:
    """Yield the logs that are named, and those found in folders; before them is told what a folder holds."""
    for path in options.logs:
        if path == STANDARD_INPUT or not path.is_dir():
            yield path, False
            continue
        found, others = sorted_out(path, columns)
        if options.json:
            for left in others:
                _show_left_out(left, options, console)
        else:
            console.print(f"{path}: {len(found)} logs, {len(others)} other files")
            logs = (f"  {_on_one_line(one.path)}: taken for {one.format}: {one.evidence}" for one in found)
            no_logs = (f"  {_on_one_line(one.path)}: no log: {one.reason}" for one in others)
            console.print_all(sorted((*logs, *no_logs)))
        yield from ((one.path, True) for one in found)


def _show_left_out(left: LeftOut, options: SimpleNamespace, console: PeopleConsole) -> None:
    if options.json:
        sys.stdout.write(dump(left_out_record(left)) + "\n")
    else:
        console.print(f"{_on_one_line(left.path)}: not a log after all: {left.reason}")


def _on_one_line(path: Path) -> str:
    return str(path).replace("\n", "\\n")


def _names(messages: Sequence[Message], can_ids: AbstractSet[int]) -> dict[int, str]:
    """Return the names of the messages that identifiers, with their flags, belong to; of several the last one's."""
    addresses = [message_address(message) for message in messages]
    later = overwritten(addresses)
    kept = [slot for slot in range(len(messages)) if slot not in later]
    book = address_book([addresses[slot] for slot in kept])
    slots = {can_id: find_slot(book, can_id) for can_id in can_ids if not can_id & (REMOTE_FLAG | ERROR_FLAG)}
    return {can_id: messages[kept[slot]].name for can_id, slot in slots.items() if slot != NOBODY}


def _why_wrong(inspection: Inspection, messages: Sequence[Message]) -> str:
    names, ids = inspection.names, {one.can_id for one in inspection.traffic.ids}
    return why_wrong(len(ids & names.keys()), len(ids), len(set(names.values())), len(messages))


def _show(inspection: Inspection, bitrate: int, console: PeopleConsole) -> None:
    console.print_all(_head(inspection, bitrate))
    if inspection.values is not None:
        console.print_all(_column_lines(inspection.traffic, inspection.values))
        return
    width = max([len(name) for name in inspection.names.values()], default=0)
    console.print(_COLUMNS.format("bus", "id", "message".ljust(width), *_HEAD), style="bold")
    for one in inspection.traffic.ids:
        console.print(_COLUMNS.format(*_row(one, inspection.names.get(one.can_id, "").ljust(width))))
    console.print_all(_protection_lines(inspection.links))


def _head(inspection: Inspection, bitrate: int) -> list[str]:
    traffic, counts = inspection.traffic, inspection.reader.counts
    duration_s = (traffic.last_ns - traffic.first_ns) / NS_PER_S
    rate = f"{bitrate / 1000:g} kbit/s"
    what = f"{inspection.reader.format.value}, {traffic.frames} frames, {len(traffic.ids)} ids, {digits(duration_s)} s"
    load = f"{100 * traffic.bus_load_ratio:.1f} %, busiest second {100 * traffic.peak_load_ratio:.1f} %"
    kinds = f"{traffic.fd_frames} CAN FD, {traffic.remote_frames} remote, {traffic.error_frames} error frames"
    kinds += f"; {traffic.sent_frames} sent by the recorder" if traffic.sent_frames else ""
    part = "" if inspection.is_whole else " (stopped early: a part of the log)"
    since = f"from {utc_from_bus_ns(traffic.first_ns)}{part}"
    lines = [f"{inspection.reader.name}: {what} {since}", f"bus load at {rate}: {load}; {kinds}"]
    if inspection.values is not None:
        what = f"signals, {traffic.frames} values of {len(traffic.ids)} columns, {digits(duration_s)} s"
        lines = [f"{inspection.reader.name}: {what} {since}"]
    lines.append(f"taken for {inspection.reader.format.value}: {inspection.reader.evidence}")
    lines += [*assumed_texts(counts), *lost_texts(counts)]
    if unlisted := traffic.unlisted_frames:
        lines.append(f"{unlisted} frames have identifiers beyond the first {MAX_IDS}, not listed one by one")
    lines.append(f"{traffic.jump_count} jumps of time" if traffic.jump_count else "no jump of time")
    lines += [
        f"  at {utc_from_bus_ns(jump.at_ns)} by {'+' if jump.by_ns > 0 else ''}{digits(jump.by_ns / NS_PER_S)} s"
        for jump in traffic.jumps
    ]
    return lines


def _column_lines(traffic: TrafficReport, values: TableValues) -> Iterator[str]:
    """Yield a line for each column of a table: how often it comes and changes, its step and its range."""
    found = sorted(((values.of(one.can_id), one) for one in traffic.ids), key=lambda pair: pair[0].name)
    width = max(len(column.name) for column, _ in found)
    yield _VALUE_COLUMNS.format("column".ljust(width), *_VALUE_HEAD)
    for column, one in found:
        yield _VALUE_COLUMNS.format(
            column.name.ljust(width),
            column.unit or "-",
            str(column.count),
            *_interval_cells(one),
            str(column.changes),
            digits(column.step),
            digits(column.lowest),
            digits(column.highest),
        )


def _row(one: IdTraffic, name: str) -> tuple[str, ...]:
    is_extended = bool(one.can_id & EXTENDED_FLAG)
    identifier = f"{one.can_id & 0x1FFF_FFFF:08X}" if is_extended else f"{one.can_id & 0x1FFF_FFFF:03X}"
    return (
        str(one.channel),
        identifier,
        name,
        str(one.count),
        str(one.length),
        *_interval_cells(one),
        str(one.gap_count),
        digits(one.longest_gap_s) if one.gap_count else "-",
    )


def _interval_cells(one: IdTraffic) -> tuple[str, str, str]:
    """Return rate, interval and how far intervals scatter, if any is known."""
    told = (one.rate_hz, one.period_s * MS_PER_S, STDS * one.jitter_s * MS_PER_S)
    rate, period, spread = map(digits, told) if one.rate_hz > 0.0 else "---"
    return rate, period, spread


def _protection_lines(links: dict[str, LinkErrors]) -> Sequence[str]:
    if not links:
        return ["no frame of a message with a known protection"]
    good = sum(link.good for link in links.values())
    bad = {name: link for name, link in links.items() if link.errors or link.missing}
    lines = [f"end-to-end protection: {good} good frames of {len(links)} messages, {len(bad)} messages with errors"]
    for name, link in bad.items():
        parts = [*(f"{count} {reason.replace('_', ' ')}" for reason, count in link.errors.items())]
        lines.append(f"  {name}: {', '.join([*parts, f'{link.missing} missing'])}")
    return lines


def propose(options: SimpleNamespace, controls: Controls) -> None:
    """Survey a log and write a profile whose comments say what there is."""
    with ReadingLine() as line:
        text = proposed_profile(
            options.log,
            options.dbc,
            lambda: controls.stop.is_set,
            watch=line.watch,
            columns=options.columns or "",
        )
    sys.stdout.write(text)
