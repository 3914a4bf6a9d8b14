"""``diag-service decode``: the signals of a log as Parquet, in bounded memory, and what is not among them."""

import sys
from types import SimpleNamespace

from canlog.logs import LogReader
from canlog.parquet_file import load_pyarrow
from canlog.tables.account import DecodeAccount
from canlog.tables.decoding import Plan, TableShape, decode_log
from canlog.tables.layouts import Values
from canlog.tables.report import account_record, frame_texts, losses, remarks, values_text
from diag_service.console.terminal import PeopleConsole
from diag_service.diagnosis.results import dump
from diag_service.errors import ConfigError, IncompleteError, StoppedError
from diag_service.mapping.databases import open_database
from diag_service.service.stopping import Controls
from fleet_contract import JsonObject


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Decode a log; the file appears when it is complete. Raises StoppedError if that was stopped."""
    if options.output.suffix.lower() != ".parquet":
        raise ConfigError(f"{options.output}: the signals are written as .parquet")
    load_pyarrow()
    messages = open_database(options.dbc, is_lenient=options.lenient).messages
    plan = Plan.of(messages, TableShape(options.layout), Values(options.values))
    decoded = decode_log(options.log, plan, options.output, lambda: controls.stop.is_set)
    if decoded is None:
        raise StoppedError("stopped early: no file was written")
    account, reader = decoded
    if options.json:
        sys.stdout.write(dump(_record(options, account, reader)) + "\n")
    else:
        _show(options, account, reader)
    lost = list(losses(account))
    if options.strict and lost:
        more = f"; and {len(lost) - 1} more" if len(lost) > 1 else ""
        raise IncompleteError(f"{options.log}: not all of it is in {options.output}: {lost[0]}{more}")


def _record(options: SimpleNamespace, account: DecodeAccount, reader: LogReader) -> JsonObject:
    """Return everything that is to be said as one JSON object."""
    return {
        **account_record(account),
        "path": str(options.log),
        "format": reader.format.value,
        "evidence": reader.evidence,
        "output": str(options.output),
        "layout": options.layout,
        "values": options.values,
    }


def _show(options: SimpleNamespace, account: DecodeAccount, reader: LogReader) -> None:
    """Say the same to people."""
    lines = [
        f"{options.log}: {reader.format.value}, {account.log.frames} frames: {', '.join(frame_texts(account))}",
        f"taken for {reader.format.value}: {reader.evidence}",
        f"{account.row_count} rows in {options.output}: {values_text(account)}",
        *losses(account),
        *remarks(account),
    ]
    console = PeopleConsole()
    for line in lines:
        console.print(line)
