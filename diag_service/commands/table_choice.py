"""From options to what is written as a table; one table and a folder of tables share it."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

from cantools.database.can import Message

from canlog.errors import SourceError
from canlog.tables.decoding import Plan, TableShape
from canlog.tables.outputs import TableFormat
from canlog.tables.table_folder import message_files, tables_there
from canlog.written_tables import TableChoice
from diag_service.commands.pairs import pairs_of
from diag_service.errors import ConfigError


def choice_of(options: SimpleNamespace) -> TableChoice:
    """Return what is asked for; raises ConfigError if pairs are none."""
    return TableChoice(
        shape=options.layout,
        values=options.values,
        signals=tuple(name.strip() for name in (options.signals or "").split(",") if name.strip()),
        begin=vars(options)["from"],
        end=options.to,
        columns=options.columns or "",
        pairs=pairs_of(options.pairs or ""),
    )


def check_messages(folder: Path, plan: Plan, table_format: TableFormat, *, is_forced: bool) -> None:
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


def planned(choice: TableChoice, messages: Sequence[Message]) -> Plan:
    """Return the plan for what is asked for; raises ConfigError if a text is no time."""
    try:
        return choice.plan(messages)
    except SourceError as exc:
        raise ConfigError(str(exc)) from exc
