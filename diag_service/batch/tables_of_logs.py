"""One log of many as a table of its own, in a process of its own; what became of it goes back."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can import Message

from canlog.errors import SourceError
from canlog.tables.account import account_record, frame_texts, losses
from canlog.tables.decoding import Decoded, Plan, decode_logs
from canlog.tables.outputs import TableFormat
from canlog.written_tables import TableChoice
from diag_service.batch.processes import follow_parent
from fleet_contract import JsonObject


@dataclass(frozen=True, slots=True, kw_only=True)
class TableTask:
    """A log, and the table that it shall be."""

    log: Path
    output: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDone:
    """What became of a log; ``error`` says why it could not be read, and is empty if it could."""

    record: JsonObject
    line: str
    losses: tuple[str, ...] = ()
    error: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableWriter:
    """Writes tables by one plan."""

    plan: Plan
    table_format: TableFormat
    columns: str

    def write(self, task: TableTask) -> TableDone:
        """Return what became of a log; raises OutputError."""
        task.output.parent.mkdir(parents=True, exist_ok=True)
        try:
            decoded = decode_logs([task.log], self.plan, task.output, self.table_format, columns=self.columns)
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
    """Prepare a process for tables."""
    follow_parent()
    _WRITERS.append(TableWriter(plan=choice.plan(messages), table_format=table_format, columns=choice.columns))


def write_own_table(task: TableTask) -> TableDone:
    """Write one table in a prepared process."""
    return _WRITERS[0].write(task)
