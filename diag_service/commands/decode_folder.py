"""``diag-service decode FOLDER... -o FOLDER``: every log a table of its own, several at a time."""

import logging
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

from cantools.database.can import Message

from canlog.column_files import SUFFIX_OF_FORMAT, TableFormat
from canlog.database.signal_columns import SignalColumn, columns_database
from canlog.errors import NOTICE, OutputError, SourceError
from canlog.logs import STANDARD_INPUT, is_folder, table_columns
from canlog.tables.account import account_record, frame_texts, losses
from canlog.tables.decoding import Decoded, Plan, TableChoice, TableShape, decode_logs
from clutchdiag_io.program import replacement_refusal
from diag_service.batch.drives import find_drives, left_out_record
from diag_service.batch.processes import follow_parent, job_count, shared_out
from diag_service.commands.decode import check_messages, choice_of, planned
from diag_service.console import PeopleConsole
from diag_service.diagnosis.records import dump
from diag_service.errors import ConfigError, IncompleteError, StoppedError
from diag_service.mapping.interpretation import asked_database
from diag_service.service.stopping import Controls
from fleet_contract import JsonObject


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


@dataclass(frozen=True, slots=True, kw_only=True)
class TableWriter:
    """Writes tables, those of logs with the same columns by one plan."""

    messages: Sequence[Message]
    choice: TableChoice
    table_format: TableFormat
    plans: dict[tuple[SignalColumn, ...], Plan] = field(default_factory=dict)

    def write(self, task: TableTask) -> TableDone:
        """Return what became of a log; raises OutputError."""
        task.output.parent.mkdir(parents=True, exist_ok=True)
        try:
            if task.columns not in self.plans:
                self.plans[task.columns] = self.choice.plan(task.messages(self.messages))
            plan, columns = self.plans[task.columns], self.choice.columns
            decoded = decode_logs([task.log], plan, task.output, self.table_format, columns=columns)
        except SourceError as exc:
            reason = str(exc).removeprefix(f"{task.log}: ")
            record: JsonObject = {"path": str(task.log), "output": None, "error": reason}
            return TableDone(record=record, line=f"{task.log}: not read: {reason}", error=reason)
        return _done(task, decoded)


def _done(task: TableTask, decoded: Decoded) -> TableDone:
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
    return TableDone(record=record, line=line, losses=tuple(losses(account)))


_WRITERS: list[TableWriter] = []  # of this process: one, made when it starts


def begin_tables(messages: Sequence[Message], choice: TableChoice, table_format: TableFormat) -> None:
    follow_parent()
    _WRITERS.append(TableWriter(messages=messages, choice=choice, table_format=table_format))


def write_own_table(task: TableTask) -> TableDone:
    return _WRITERS[0].write(task)


_LOG = logging.getLogger(__name__)


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Decode logs into tables of their own; raises StoppedError if that was stopped before all were written."""
    table_format = TableFormat(options.format or TableFormat.PARQUET)
    choice = replace(choice_of(options), table_format=table_format.value)
    try:
        choice.format_of(options.output)
    except OutputError as exc:
        raise ConfigError(str(exc)) from exc
    jobs = job_count(options.jobs)
    messages = asked_database(SimpleNamespace(**{**vars(options), "logs": ()})).messages
    tasks = _tasks(options, "" if options.layout == TableShape.MESSAGES else SUFFIX_OF_FORMAT[table_format])
    plans = {task.columns: planned(choice, task.messages(messages)) for task in tasks}  # complains of what is none
    for task in tasks:
        check_messages(task.output, plans[task.columns], table_format, is_forced=options.force)
    console, totals, losing = PeopleConsole(), Counter[str](), list[str]()
    arguments = (messages, choice, table_format)
    for task, future in shared_out(write_own_table, tasks, jobs, controls.stop, begin_tables, arguments):
        try:
            done = future.result()
        except BrokenProcessPool as exc:
            raise SourceError(f"a process died while it decoded {task.log} or a log beside it") from exc
        totals["failed" if done.error else "done"] += 1
        losing += [f"{task.log}: {(done.losses or (done.error,))[0]}"] if done.losses or done.error else []
        _show_done(done, options, console)
    if totals.total() < len(tasks):
        raise StoppedError(f"stopped early: {totals['done']} of {len(tasks)} tables were written")
    if not options.json:
        console.print(f"{totals['done']} tables in {options.output}, {totals['failed']} logs could not be read")
    if totals["failed"] == len(tasks):
        raise SourceError(f"none of {len(tasks)} logs could be read; {losing[0]}")
    if options.strict and losing:
        raise IncompleteError(f"not all of {len(losing)} logs is in their tables: {losing[0]}")


def _tasks(options: SimpleNamespace, suffix: str) -> list[TableTask]:
    """Return the logs with their tables, or folders of tables if these have no suffix.

    Raises ConfigError if a table is there already, two would be one, or a table would be among the logs.
    """
    if STANDARD_INPUT in options.logs:
        raise ConfigError("tables of a folder are written by several processes: standard input does not go with them")
    if options.output.exists() and not options.output.is_dir():
        raise ConfigError(f"{options.output} is not a folder: each log of a folder becomes a table of its own")
    tasks = []
    for path in options.logs:
        if path.is_dir() and options.output.resolve().is_relative_to(path.resolve()):
            raise ConfigError(f"{options.output} lies in {path}: the next run would take tables for logs")
        found = find_drives([path], columns=options.columns or "")
        for left in found.left_out:
            _LOG.log(NOTICE, "left out: %s: %s", left.path, left.reason)
            if options.json:
                sys.stdout.write(dump(left_out_record(left)) + "\n")
        home = path if is_folder(path) else path.parent
        for log in (log for drive in found.drives for log in drive.paths):
            own = log.relative_to(home)
            columns = () if options.dbc is not None else table_columns(log, columns=options.columns or "")
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


def _show_done(done: TableDone, options: SimpleNamespace, console: PeopleConsole) -> None:
    if options.json:
        sys.stdout.write(dump({**done.record, "layout": options.layout, "values": options.values}) + "\n")
        sys.stdout.flush()
        return
    for line in (done.line, *(f"  {loss}" for loss in done.losses)):
        console.print(line)
