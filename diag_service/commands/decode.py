"""``diag-service decode``: the signals of logs as a table, or as one for each log of a folder, and what is missing."""

import logging
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO, Final, Literal

from cantools.database.can import Message

from canlog.column_files import FORMAT_OF_SUFFIX, STREAMED, SUFFIX_OF_FORMAT, TableFormat, load_pyarrow
from canlog.database.signal_columns import SignalColumn, columns_database
from canlog.errors import NOTICE, OutputError, SourceError
from canlog.logs import STANDARD_INPUT, shown_name, table_columns
from canlog.tables.account import DecodeAccount, account_record, frame_texts, losses, remarks, values_text
from canlog.tables.decoding import DecodedLogs, Plan, TableChoice, TableShape, decode_logs, default_shape
from canlog.tables.table_folder import message_files, tables_there
from clutchdiag_io.command_line import STANDARD_STREAM
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.program import replacement_refusal
from diag_service.console import ReadingLine
from diag_service.errors import ConfigError, IncompleteError, StoppedError
from diag_service.mapping.interpretation import open_database
from diag_service.service.stopping import Controls
from fleet_contract import JsonObject

_LOG = logging.getLogger(__name__)
NOTHING_KNOWN: Final = "is it the right database? Try diag-service signals LOG --dbc FILE, which lists what it finds"

BUILT_IN_FITS_NOT: Final = (
    "the log is not of the emulated vehicle, whose database is used without --dbc: "
    "name that of this bus with --dbc FILE"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodeOptions:
    """What of which logs becomes which tables."""

    logs: tuple[Path, ...]
    output: Path
    force: bool
    table_format: str | None
    dbc: Path | None
    match: str
    columns: str
    layout: Literal["messages", "wide"] | None
    values: Literal["numbers", "texts", "both"]
    signals: str
    begin: str | None
    end: str | None
    jobs: int | None
    strict: bool
    json: bool


def decode(options: DecodeOptions, controls: Controls) -> None:
    """Decode logs; a file appears when it is complete. Raises StoppedError if that was stopped."""
    has_folders = any(path.is_dir() for path in options.logs if path != STANDARD_INPUT)
    layout = options.layout or default_shape(options.output, is_folder=has_folders)
    options = replace(options, layout=layout)
    is_of_messages = layout == "messages"
    if has_folders or (options.output.is_dir() and not is_of_messages):
        _decode_folders(options, controls)
        return
    if options.jobs is not None:
        raise ConfigError("--jobs is for folders: the logs that were named are one table")
    table_format = table_format_of(options.output, options.table_format, is_folder=is_of_messages)
    _check(options, table_format)
    messages = open_database(
        options.dbc,
        options.logs,
        is_j1939=options.match == "group",
        is_stopped=lambda: controls.stop.is_set,
        columns=options.columns,
    ).messages
    plan = _planned(_choice_of(options), messages)
    _check_messages(options.output, plan, table_format, is_forced=options.force)
    is_piped = options.output == STANDARD_STREAM
    output: Path | BinaryIO = sys.stdout.buffer if is_piped else options.output
    with ReadingLine() as line:
        decoded = decode_logs(
            options.logs, plan, output, table_format, lambda: controls.stop.is_set, line.watch, options.columns
        )
    if not decoded.is_whole:
        raise StoppedError(f"stopped early: {'a part was written' if is_piped else 'no file was written'}")
    if options.json:
        _print_record(_record(options, decoded))
    else:
        _show(options, decoded, PeopleConsole(stderr=is_piped))
    lost = list(losses(decoded.account))
    is_built_in = options.dbc is None and not any(reader.columns for reader in decoded.readers)
    if is_built_in and _fits_not(decoded.account):
        raise ConfigError(BUILT_IN_FITS_NOT)
    if options.strict and lost:
        more = f"; and {len(lost) - 1} more" if len(lost) > 1 else ""
        names = ", ".join(map(shown_name, options.logs))
        raise IncompleteError(f"{names}: not all of it is in {_place(options)}: {lost[0]}{more}")


def table_format_of(output: Path, named: str | None, *, is_folder: bool = False) -> TableFormat:
    """Return the format that was asked for, by name or by suffix; raises ConfigError."""
    if named is not None:
        return TableFormat(named)
    if output == STANDARD_STREAM:
        return TableFormat.CSV
    if is_folder:
        return TableFormat.PARQUET
    try:
        return FORMAT_OF_SUFFIX[output.suffix.lower()]
    except KeyError:
        known = ", ".join(FORMAT_OF_SUFFIX)
        raise ConfigError(f"{output}: the signals are written as {known}, or as --format says") from None


def _check(options: DecodeOptions, table_format: TableFormat) -> None:
    """Raise ConfigError if the words contradict each other, ExtraMissingError if the format needs what is missing."""
    is_piped = options.output == STANDARD_STREAM
    if is_piped and table_format not in STREAMED:
        raise ConfigError(f"{table_format} does not go to standard output; csv, jsonl and arrow do")
    if is_piped and options.json:
        raise ConfigError("the table goes to standard output: --json cannot be used")
    is_of_messages = options.layout == "messages"
    if is_piped and is_of_messages:
        raise ConfigError("tables of messages are a folder, and do not go to standard output")
    if len(options.logs) > 1:
        from diag_service.service.drive import check_distinct  # noqa: PLC0415 - a drive is a lot to import

        check_distinct(options.logs)
    if not is_piped and not is_of_messages and (text := replacement_refusal(options.output, is_forced=options.force)):
        raise ConfigError(text)
    load_pyarrow()


def _print_record(record: JsonObject) -> None:
    from clutch_results.records import dump  # noqa: PLC0415 - records of shifts are a lot to import

    sys.stdout.write(dump(record) + "\n")


def _place(options: DecodeOptions) -> str:
    return "standard output" if options.output == STANDARD_STREAM else str(options.output)


def _record(options: DecodeOptions, decoded: DecodedLogs) -> JsonObject:
    """Return everything that is to be said as one JSON object."""
    logs: list[JsonObject] = [
        {
            "path": str(path),
            "format": reader.format.value,
            "evidence": reader.evidence,
            "frames": reader.counts.frames,
            "truncated": reader.counts.truncated,
        }
        for path, reader in zip(options.logs, decoded.readers, strict=True)
    ]
    tables = {"tables": decoded.tables} if decoded.tables else {}
    first = {key: logs[0][key] for key in ("path", "format", "evidence")} if len(logs) == 1 else {}
    return {
        **account_record(decoded.account),
        **first,
        "logs": logs,
        "output": str(options.output),
        **tables,
        "layout": options.layout,
        "values": options.values,
    }


def _show(options: DecodeOptions, decoded: DecodedLogs, console: PeopleConsole) -> None:
    account = decoded.account
    fates = ", ".join(frame_texts(account))
    lines = list[str]()
    for reader in decoded.readers:
        own = f": {fates}" if len(decoded.readers) == 1 else ""
        lines.append(f"{reader.name}: {reader.format.value}, {reader.counts.frames} frames{own}")
        lines.append(f"taken for {reader.format.value}: {reader.evidence}")
    lines += [f"{account.log.frames} frames: {fates}"] if len(decoded.readers) > 1 else []
    lines += [f"{account.row_count} rows in {_place(options)}: {values_text(account)}"]
    hint = [NOTHING_KNOWN] if account.knows_nothing else []
    for line in (*lines, *losses(account), *remarks(account), *hint):
        console.print(line)


def _choice_of(options: DecodeOptions) -> TableChoice:
    """Return what is asked for."""
    return TableChoice(
        shape=options.layout,
        values=options.values,
        signals=tuple(name.strip() for name in options.signals.split(",") if name.strip()),
        begin=options.begin,
        end=options.end,
        columns=options.columns,
    )


def _check_messages(folder: Path, plan: Plan, table_format: TableFormat, *, is_forced: bool) -> None:
    """Raise ConfigError if tables of messages must not be written to a folder; other tables are no concern."""
    if plan.shape is not TableShape.MESSAGES:
        return
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is not a folder: each message becomes a table of its own")
    there = [] if is_forced else tables_there(folder, message_files(plan.names, table_format))
    if there:
        raise ConfigError(
            f"{there[0]} is there already; --force writes over tables of messages, and removes older ones"
        )


def _planned(choice: TableChoice, messages: Sequence[Message]) -> Plan:
    """Return the plan for what is asked for; raises ConfigError if a text is no time."""
    try:
        return choice.plan(messages)
    except SourceError as exc:
        raise ConfigError(str(exc)) from exc


@dataclass(frozen=True, slots=True, kw_only=True)
class TableTask:
    """A log, and the table that it shall be."""

    log: Path
    output: Path
    columns: tuple[SignalColumn, ...] = ()  # of a table of signals, which is its own database

    def messages(self, others: Sequence[Message]) -> Sequence[Message]:
        """Return the messages of the log: its columns, or those of the database of all other logs."""
        return columns_database(self.columns).messages if self.columns else others


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDone:
    """What became of a log; ``error`` says why it could not be read, and is empty if it could."""

    record: JsonObject
    line: str
    losses: tuple[str, ...] = ()
    error: str = ""
    fits_not: bool = False  # whether the database is probably that of another bus


@dataclass(frozen=True, slots=True, kw_only=True)
class TableWriter:
    """Writes tables, those of logs with the same columns by one plan."""

    messages: Sequence[Message]
    choice: TableChoice
    table_format: TableFormat
    plans: dict[tuple[SignalColumn, ...], Plan] = field(default_factory=dict)

    def write(self, task: TableTask) -> TableDone:
        """Return what became of a log; raises OutputError."""
        try:
            task.output.parent.mkdir(parents=True, exist_ok=True)
            if task.columns not in self.plans:
                self.plans[task.columns] = self.choice.plan(task.messages(self.messages))
            plan, columns = self.plans[task.columns], self.choice.columns
            decoded = decode_logs([task.log], plan, task.output, self.table_format, columns=columns)
        except SourceError as exc:
            return _not_read(task, str(exc).removeprefix(f"{task.log}: "))
        except OSError as exc:
            raise OutputError(f"cannot write {task.output}: {exc.strerror or exc}") from exc
        return _done(task, decoded)


def _not_read(task: TableTask, reason: str) -> TableDone:
    record: JsonObject = {"path": str(task.log), "output": None, "error": reason}
    return TableDone(record=record, line=f"{task.log}: not read: {reason}", error=reason)


def _done(task: TableTask, decoded: DecodedLogs) -> TableDone:
    (reader,) = decoded.readers
    account = decoded.account
    record: JsonObject = {
        **account_record(account),
        "path": str(task.log),
        "format": reader.format.value,
        "evidence": reader.evidence,
        "output": str(task.output),
        "error": None,
    }
    rows = f"{account.row_count} rows in {task.output}"
    line = f"{task.log}: {reader.format.value}, {account.log.frames} frames: {', '.join(frame_texts(account))}; {rows}"
    fits_not = not task.columns and _fits_not(account)
    return TableDone(record=record, line=line, losses=tuple(losses(account)), fits_not=fits_not)


def _fits_not(account: DecodeAccount) -> bool:
    return account.knows_nothing or bool(account.why_wrong)


_WRITERS: list[TableWriter] = []  # of this process: one, made when it starts


def begin_tables(messages: Sequence[Message], choice: TableChoice, table_format: TableFormat) -> None:
    from diag_service.batch.worker import follow_parent  # noqa: PLC0415 - one table needs none of it

    follow_parent()
    _WRITERS.append(TableWriter(messages=messages, choice=choice, table_format=table_format))


def write_own_table(task: TableTask) -> TableDone:
    return _WRITERS[0].write(task)


def _decode_folders(options: DecodeOptions, controls: Controls) -> None:
    """Decode logs into tables of their own; raises StoppedError if that was stopped before all were written."""
    from diag_service.batch.worker import DEADLY, job_count, shared_out  # noqa: PLC0415 - one table needs none of it

    table_format = TableFormat(options.table_format or TableFormat.PARQUET)
    choice = replace(_choice_of(options), table_format=table_format.value)
    try:
        choice.format_of(options.output)
    except OutputError as exc:
        raise ConfigError(str(exc)) from exc
    jobs = job_count(options.jobs)
    messages = open_database(options.dbc, is_j1939=options.match == "group").messages
    tasks = _tasks(options, "" if options.layout == "messages" else SUFFIX_OF_FORMAT[table_format])
    plans = {task.columns: _planned(choice, task.messages(messages)) for task in tasks}  # complains of what is none
    for task in tasks:
        _check_messages(task.output, plans[task.columns], table_format, is_forced=options.force)
    console, totals, losing, foreign = PeopleConsole(), Counter[str](), list[str](), list[Path]()
    arguments = (messages, choice, table_format)
    for task, future in shared_out(write_own_table, tasks, jobs, controls.stop, begin_tables, arguments):
        try:
            done = future.result()
        except BrokenProcessPool:
            done = _not_read(task, DEADLY)
        totals["failed" if done.error else "done"] += 1
        losing += [f"{task.log}: {(done.losses or (done.error,))[0]}"] if done.losses or done.error else []
        foreign += [task.log] if done.fits_not else []
        _show_done(done, options, console)
    if totals.total() < len(tasks):
        raise StoppedError(f"stopped early: {totals['done']} of {len(tasks)} tables were written")
    if not options.json:
        console.print(f"{totals['done']} tables in {options.output}, {totals['failed']} logs could not be read")
    if totals["failed"] == len(tasks):
        raise SourceError(f"none of {len(tasks)} logs could be read; {losing[0]}")
    if options.dbc is None and foreign:
        raise ConfigError(f"{foreign[0]}: {BUILT_IN_FITS_NOT}")
    if options.strict and losing:
        raise IncompleteError(f"not all of {len(losing)} logs is in their tables: {losing[0]}")


def _tasks(options: DecodeOptions, suffix: str) -> list[TableTask]:
    """Return the logs with their tables, or folders of tables if these have no suffix.

    Raises ConfigError if a table is there already, two would be one, or a table would be among the logs.
    """
    from diag_service.batch.drives import find_drives, left_out_record  # noqa: PLC0415 - one table needs none of it

    if STANDARD_INPUT in options.logs:
        raise ConfigError("tables of a folder are written by several processes: standard input does not go with them")
    if options.output.exists() and not options.output.is_dir():
        raise ConfigError(f"{options.output} is not a folder: each log of a folder becomes a table of its own")
    tasks = []
    for path in options.logs:
        if path.is_dir() and options.output.resolve().is_relative_to(path.resolve()):
            raise ConfigError(f"{options.output} lies in {path}: the next run would take tables for logs")
        found = find_drives([path], columns=options.columns)
        for left in found.left_out:
            _LOG.log(NOTICE, "left out: %s: %s", left.path, left.reason)
            if options.json:
                _print_record(left_out_record(left))
        home = path if path.is_dir() else path.parent
        for log in (log for drive in found.drives for log in drive.paths):
            own = log.relative_to(home)
            columns = () if options.dbc is not None else table_columns(log, columns=options.columns)
            output = options.output / own.with_name(f"{own.name}{suffix}")
            tasks.append(TableTask(log=log, output=output, columns=columns))
    _check_outputs([task.output for task in tasks], are_files=bool(suffix), is_forced=options.force)
    return tasks


def _check_outputs(outputs: Sequence[Path], *, are_files: bool, is_forced: bool) -> None:
    counts = Counter(outputs)
    if twice := [str(output) for output, count in counts.items() if count > 1]:
        raise ConfigError(f"two logs would be the same table: {', '.join(twice)}")
    for output in counts:
        if are_files and (text := replacement_refusal(output, is_forced=is_forced)):
            raise ConfigError(text)


def _show_done(done: TableDone, options: DecodeOptions, console: PeopleConsole) -> None:
    if options.json:
        _print_record({**done.record, "layout": options.layout, "values": options.values})
        sys.stdout.flush()
        return
    console.print_all((done.line, *(f"  {loss}" for loss in done.losses)))
