"""``diag-service decode``: the signals of logs as a table, in bounded memory, and what is not among them."""

import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import BinaryIO, Final

from cantools.database.can import Message

from canlog.column_files import FORMAT_OF_SUFFIX, STREAMED, TableFormat, check_libraries
from canlog.errors import SourceError
from canlog.logs import STANDARD_INPUT, is_folder, shown_name
from canlog.tables.account import account_record, frame_texts, losses, remarks, values_text
from canlog.tables.decoding import Decoded, Plan, TableChoice, TableShape, decode_logs, default_shape
from canlog.tables.table_folder import message_files, tables_there
from clutchdiag_io.command_line import STANDARD_STREAM
from clutchdiag_io.program import replacement_refusal
from diag_service.commands.talks import pairs_of
from diag_service.console import PeopleConsole, ReadingLine
from diag_service.errors import ConfigError, IncompleteError, StoppedError
from diag_service.mapping.interpretation import asked_database
from diag_service.service.stopping import Controls
from fleet_contract import JsonObject

NOTHING_KNOWN: Final = "is it the right database? Try diag-service signals LOG --dbc FILE, which lists what it finds"


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Decode logs; a file appears when it is complete. Raises StoppedError if that was stopped."""
    has_folders = any(is_folder(path) for path in options.logs if path != STANDARD_INPUT)
    layout = options.layout or default_shape(options.output, options.format, is_folder=has_folders)
    options = SimpleNamespace(**{**vars(options), "layout": layout})
    is_of_messages = layout == TableShape.MESSAGES
    if has_folders or (options.output.is_dir() and not is_of_messages):
        from diag_service.commands import decode_folder  # noqa: PLC0415 - one table needs none of it

        decode_folder.execute(options, controls)
        return
    if options.jobs is not None:
        raise ConfigError("--jobs is for folders: the logs that were named are one table")
    table_format = table_format_of(options.output, options.format, is_folder=is_of_messages)
    _check(options, table_format)
    messages = asked_database(options, lambda: controls.stop.is_set).messages
    plan = planned(choice_of(options), messages)
    check_messages(options.output, plan, table_format, is_forced=options.force)
    is_piped = options.output == STANDARD_STREAM
    output: Path | BinaryIO = sys.stdout.buffer if is_piped else options.output
    with ReadingLine() as line:
        decoded = decode_logs(
            options.logs, plan, output, table_format, lambda: controls.stop.is_set, line.watch, options.columns or ""
        )
    if not decoded.is_whole:
        raise StoppedError(f"stopped early: {'a part was written' if is_piped else 'no file was written'}")
    if options.json:
        from diag_service.diagnosis.records import dump  # noqa: PLC0415 - the records of results take a while

        sys.stdout.write(dump(_record(options, decoded)) + "\n")
    else:
        _show(options, decoded, PeopleConsole(stderr=is_piped))
    lost = list(losses(decoded.account))
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


def _check(options: SimpleNamespace, table_format: TableFormat) -> None:
    """Raise ConfigError if the words contradict each other, ExtraMissingError if the format needs what is missing."""
    is_piped = options.output == STANDARD_STREAM
    if is_piped and table_format not in STREAMED:
        raise ConfigError(f"{table_format} does not go to standard output; csv, jsonl and arrow do")
    if is_piped and options.json:
        raise ConfigError("the table goes to standard output: --json cannot be used")
    is_of_messages = options.layout == TableShape.MESSAGES
    if is_piped and is_of_messages:
        raise ConfigError("tables of messages are a folder, and do not go to standard output")
    if len(options.logs) > 1:
        from diag_service.service.drive import check_distinct  # noqa: PLC0415 - a drive is a lot to import

        check_distinct(options.logs)
    if table_format is TableFormat.MF4 and (options.layout, options.values) != ("wide", "numbers"):
        raise ConfigError("an MF4 file has a group per message and numbers: neither --layout nor --values applies")
    if not is_piped and not is_of_messages and (text := replacement_refusal(options.output, is_forced=options.force)):
        raise ConfigError(text)
    check_libraries(table_format, options.logs)


def _place(options: SimpleNamespace) -> str:
    return "standard output" if options.output == STANDARD_STREAM else str(options.output)


def _record(options: SimpleNamespace, decoded: Decoded) -> JsonObject:
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


def _show(options: SimpleNamespace, decoded: Decoded, console: PeopleConsole) -> None:
    account = decoded.account
    fates = ", ".join(frame_texts(account))
    lines = list[str]()
    for reader in decoded.readers:
        own = f": {fates}" if len(decoded.readers) == 1 else ""
        lines.append(f"{reader.name}: {reader.format.value}, {reader.counts.frames} frames{own}")
        lines.append(f"taken for {reader.format.value}: {reader.evidence}")
    lines += [f"{account.log.frames} frames: {fates}"] if len(decoded.readers) > 1 else []
    lines += [f"{account.row_count} rows in {_place(options)}: {values_text(account)}"]
    hint = [NOTHING_KNOWN] if account.frames_of_id and not account.known_count else []
    for line in (*lines, *losses(account), *remarks(account), *hint):
        console.print(line)


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
