"""The signals of logs as a table, or as one for each log of a folder, and what is missing."""

import logging
import sys
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import BinaryIO, Final

from cantools.database.can import Message

from canlog.column_files import STREAMED, SUFFIX_OF_FORMAT, TableFormat, load_pyarrow
from canlog.database.signal_columns import SignalColumn, columns_database
from canlog.errors import NOTICE, OutputError, SourceError
from canlog.files import is_folder, is_there
from canlog.logs import STANDARD_INPUT, shown_name, table_columns
from canlog.tables.account import DecodeAccount, account_record, frame_texts, losses
from canlog.tables.decoding import DecodedLogs, Plan, TableChoice, TableShape, decode_logs, default_shape
from canlog.tables.table_folder import message_files, tables_there
from clutchdiag_io.command_line import STANDARD_STREAM
from diag_service.batch.drives import LeftOut, find_drives
from diag_service.console import ReadingLine
from diag_service.errors import ConfigError, IncompleteError, StoppedError
from diag_service.mapping.interpretation import open_database
from diag_service.service.drive import check_distinct
from diag_service.settings.options import DecodeOptions, check_replaceable, messages_of
from diag_service.stopping import Controls
from fleet_contract import JsonObject

_LOG = logging.getLogger(__name__)
BUILT_IN_FITS_NOT: Final = (
    "the log is not of the emulated vehicle, whose database is used without --dbc: "
    "name that of this bus with --dbc FILE"
)


def arranged(options: DecodeOptions) -> tuple[DecodeOptions, bool]:
    """Return the options with their layout, and whether each log becomes tables of its own."""
    has_folders = any(is_folder(path) for path in options.logs if path != STANDARD_INPUT)
    options = replace(options, layout=options.layout or default_shape(options.output, is_of_folder=has_folders))
    return options, has_folders or (is_folder(options.output) and options.layout != "messages")


def decode_together(
    options: DecodeOptions,
    controls: Controls,
    line: ReadingLine,
    conclude: Callable[[DecodedLogs], None],
) -> None:
    """Decode logs into one table, or one per message; a file appears when it is complete.

    ``conclude`` hears what became of the frames before this raises ConfigError for a wrong database, or IncompleteError
    where ``strict`` is set and something is missing. Raises StoppedError if it was stopped.
    """
    if options.jobs is not None:
        raise ConfigError("--jobs is for folders: the logs that were named are one table")
    try:
        table_format = _choice_of(options).format_of(options.output)
    except OutputError as exc:
        raise ConfigError(str(exc)) from exc
    _check(options, table_format)
    plan = _planned(options, messages_of(options, lambda: controls.stop.is_set))
    _check_messages(options.output, plan, table_format, is_forced=options.force)
    is_piped = options.output == STANDARD_STREAM
    output: Path | BinaryIO = sys.stdout.buffer if is_piped else options.output
    decoded = decode_logs(
        options.logs, plan, output, table_format, lambda: controls.stop.is_set, line.watch, options.columns
    )
    if not decoded.is_whole:
        raise StoppedError(f"stopped early: {'a part was written' if is_piped else 'no file was written'}")
    conclude(decoded)
    lost = list(losses(decoded.account))
    is_built_in = options.dbc is None and not any(reader.columns for reader in decoded.readers)
    if is_built_in and _fits_not(decoded.account):
        raise ConfigError(BUILT_IN_FITS_NOT)
    if options.strict and lost:
        more = f"; and {len(lost) - 1} more" if len(lost) > 1 else ""
        names = ", ".join(map(shown_name, options.logs))
        raise IncompleteError(f"{names}: not all of it is in {place_of(options)}: {lost[0]}{more}")


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
        check_distinct(options.logs)
    if not is_piped and not is_of_messages:
        check_replaceable(options.output, is_forced=options.force)
    load_pyarrow()


def place_of(options: DecodeOptions) -> str:
    return "standard output" if options.output == STANDARD_STREAM else str(options.output)


def _choice_of(options: DecodeOptions) -> TableChoice:
    """Return what is asked for."""
    return TableChoice(
        table_format=options.table_format or ("csv" if options.output == STANDARD_STREAM else None),
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
    if is_there(folder) and not is_folder(folder):
        raise ConfigError(f"{folder} is not a folder: each message becomes a table of its own")
    there = [] if is_forced else tables_there(folder, message_files(plan.names, table_format))
    if there:
        raise ConfigError(
            f"{there[0]} is there already; --force writes over tables of messages, and removes older ones"
        )


def _planned(options: DecodeOptions, messages: Sequence[Message]) -> Plan:
    """Return the plan for what is asked for; raises ConfigError if a text is no time."""
    try:
        return _choice_of(options).plan(messages)
    except SourceError as exc:
        raise ConfigError(str(exc)) from exc


@cache  # in each process
def _plan_of_each(options: DecodeOptions, columns: tuple[SignalColumn, ...]) -> Plan:
    """Return the plan of logs with these columns, or of all other logs."""
    database = columns_database(columns) if columns else open_database(options.dbc, is_j1939=options.match == "group")
    return _planned(options, database.messages)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableTask:
    """A log, and the table that it shall be."""

    log: Path
    output: Path
    columns: tuple[SignalColumn, ...] = ()  # of a table of signals, which is its own database


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDone:
    """What became of a log; ``error`` says why it could not be read, and is empty if it could."""

    record: JsonObject
    line: str
    losses: tuple[str, ...] = ()
    error: str = ""
    fits_not: bool = False  # whether the database is probably that of another bus


def write_table_of(options: DecodeOptions, table_format: TableFormat, task: TableTask) -> TableDone:
    """Decode one log in a process of its own, and return what became of it; raises OutputError."""
    plan = _plan_of_each(options, task.columns)
    try:
        task.output.parent.mkdir(parents=True, exist_ok=True)
        decoded = decode_logs([task.log], plan, task.output, table_format, columns=options.columns)
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
    fates = ", ".join(frame_texts(account))
    line = f"{task.log}: {reader.format.value}, {account.log.frames} {reader.format.content}: {fates}; {rows}"
    fits_not = not task.columns and _fits_not(account)
    return TableDone(record=record, line=line, losses=tuple(losses(account)), fits_not=fits_not)


def _fits_not(account: DecodeAccount) -> bool:
    return account.knows_nothing or bool(account.why_wrong)


def decode_each(
    options: DecodeOptions, controls: Controls
) -> Generator[LeftOut | TableDone | Mapping[str, int], None, None]:
    """Decode logs into tables of their own; yield files that are no logs, each table, and then the totals.

    The totals are how many are ``done`` and ``failed``. After them: SourceError if all failed, ConfigError for a wrong
    database, IncompleteError where ``strict`` is set. Raises StoppedError if it was stopped.
    """
    from diag_service.batch.worker import DEADLY, job_count, run_in_processes  # noqa: PLC0415 - it loads the diagnosis

    table_format = TableFormat(options.table_format or TableFormat.PARQUET)
    jobs = job_count(options.jobs)
    suffix = "" if options.layout == "messages" else SUFFIX_OF_FORMAT[table_format]
    tasks, left_out = _tasks(options, suffix)
    for left in left_out:
        _LOG.log(NOTICE, "left out: %s: %s", left.path, left.reason)
        yield left
    for task in tasks:
        _check_messages(task.output, _plan_of_each(options, task.columns), table_format, is_forced=options.force)
    totals, losing, foreign = Counter[str](), list[str](), list[Path]()
    write = partial(write_table_of, options, table_format)
    for task, future in run_in_processes(write, tasks, jobs, controls.stop, is_shown=False):
        try:
            done = future.result()
        except BrokenProcessPool:
            done = _not_read(task, DEADLY)
        totals["failed" if done.error else "done"] += 1
        losing += [f"{task.log}: {(done.losses or (done.error,))[0]}"] if done.losses or done.error else []
        foreign += [task.log] if done.fits_not else []
        yield done
    if totals.total() < len(tasks):
        raise StoppedError(f"stopped early: {totals['done']} of {len(tasks)} tables were written")
    yield totals
    if totals["failed"] == len(tasks):
        raise SourceError(f"none of {len(tasks)} logs could be read; {losing[0]}")
    if options.dbc is None and foreign:
        raise ConfigError(f"{foreign[0]}: {BUILT_IN_FITS_NOT}")
    if options.strict and losing:
        raise IncompleteError(f"not all of {len(losing)} logs is in their tables: {losing[0]}")


def _tasks(options: DecodeOptions, suffix: str) -> tuple[list[TableTask], list[LeftOut]]:
    """Return the logs with their tables, or folders of tables if these have no suffix, and files that are no logs.

    Raises ConfigError if a table is there already, two would be one, or a table would be among the logs.
    """
    if STANDARD_INPUT in options.logs:
        raise ConfigError("tables of a folder are written by several processes: standard input does not go with them")
    if is_there(options.output) and not is_folder(options.output):
        raise ConfigError(f"{options.output} is not a folder: each log of a folder becomes a table of its own")
    tasks, left_out = list[TableTask](), list[LeftOut]()
    for path in options.logs:
        if is_folder(path) and options.output.resolve().is_relative_to(path.resolve()):
            raise ConfigError(f"{options.output} lies in {path}: the next run would take tables for logs")
        drives, others = find_drives([path], columns=options.columns)
        left_out += others
        home = path if is_folder(path) else path.parent
        for log in (log for drive in drives for log in drive.paths):
            name = log.relative_to(home)
            columns = () if options.dbc is not None else table_columns(log, columns=options.columns)
            output = options.output / name.with_name(f"{name.name}{suffix}")
            tasks.append(TableTask(log=log, output=output, columns=columns))
    outputs = Counter(task.output for task in tasks)
    if twice := [str(output) for output, count in outputs.items() if count > 1]:
        raise ConfigError(f"two logs would be the same table: {', '.join(twice)}")
    for output in outputs if suffix else ():
        check_replaceable(output, is_forced=options.force)
    return tasks, left_out
