"""``diag-service decode``: the signals of a log as Parquet, in bounded memory, and what is not among them."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from canlog.decode.codec import HAS_VALUES, Codec
from canlog.frames import FrameBatch
from canlog.logs import LogReader, read_log
from canlog.parquet_file import ParquetTable, load_pyarrow
from canlog.tables.account import Account
from canlog.tables.layouts import LongLayout, WideLayout
from canlog.tables.names import TableNames, table_names
from canlog.tables.record import account_record
from canlog.tables.report import frame_texts, losses, remarks, values_text
from canlog.tables.texts import Values
from diag_service.console.terminal import PeopleConsole
from diag_service.diagnosis.results import JsonObject, dump
from diag_service.errors import ConfigError, IncompleteError, StoppedError, StoreError
from diag_service.mapping.databases import open_database
from diag_service.service.stopping import Trigger

MAX_CELLS = 4_000_000  # of a row group: 32 MB of numbers
CELLS_PER_FRAME = 64  # of the long table, at most as a rule


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is decoded, and how it is written."""

    log: Path
    codec: Codec
    names: TableNames
    layout: str
    values: Values


def execute(options: argparse.Namespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Decode a log; the file appears when it is complete. Raises StoppedError if that was stopped."""
    del counts_wanted
    if options.output.suffix.lower() != ".parquet":
        raise ConfigError(f"{options.output}: the signals are written as .parquet")
    load_pyarrow()
    codec = Codec(open_database(options.dbc, is_lenient=bool(options.lenient)).messages)
    plan = Plan(
        log=options.log,
        codec=codec,
        names=table_names(codec.tables),
        layout=options.layout,
        values=Values(options.values),
    )
    part = options.output.with_name(f".{options.output.name}.part")
    try:
        account, reader = decode_log(plan, part, stop)
        if stop.is_set:
            raise StoppedError("stopped early: no file was written")
        part.replace(options.output)
    except OSError as exc:
        raise StoreError(f"cannot write {options.output}: {exc.strerror or exc}") from exc
    finally:
        part.unlink(missing_ok=True)
    if options.json:
        sys.stdout.write(dump(_record(plan, account, reader, options.output)) + "\n")
    else:
        _show(plan, account, reader, options.output)
    lost = list(losses(account))
    if options.strict and lost:
        more = f"; and {len(lost) - 1} more" if len(lost) > 1 else ""
        raise IncompleteError(f"{options.log}: not all of it is in {options.output}: {lost[0]}{more}")


def decode_log(plan: Plan, output: Path, stop: Trigger) -> tuple[Account, LogReader]:
    """Write the table of a log; return the account and the reader.

    For wide rows the log is read twice: first for the messages that occur, which are the columns.
    """
    layout: WideLayout | LongLayout
    if plan.layout == "wide":
        slots = _slots_in(plan, stop)
        layout = WideLayout(plan.codec.tables, plan.names, plan.values, slots)
        size = max(1, MAX_CELLS // len(layout.kinds))
    else:
        layout = LongLayout(plan.codec.tables, plan.names, plan.values)
        size = max(1, MAX_CELLS // CELLS_PER_FRAME)
    account = Account(codec=plan.codec, names=plan.names)
    with closing(read_log(plan.log)) as reader, ParquetTable(output, layout.kinds, layout.metadata) as table:
        for batch in _pieces(reader, size, stop):
            match = plan.codec.match(batch)
            found = list(plan.codec.decode(batch, match))
            account.add(batch, match)
            for one in found:
                account.add_values(one)
            count, columns = layout.columns(batch, found) if found else (0, {})
            if count:
                table.write_columns(columns)
                account.row_count += count
        account.log = reader.counts
    return account, reader


def _slots_in(plan: Plan, stop: Trigger) -> list[int]:
    """Return the messages with values that a log holds."""
    seen: set[int] = set()
    with closing(read_log(plan.log)) as reader:
        for batch in reader:
            if stop.is_set:
                break
            counts = plan.codec.match(batch).counts[:-1, list(HAS_VALUES)]
            seen.update(np.flatnonzero(counts.sum(axis=1)).tolist())
    return sorted(seen)


def _pieces(reader: LogReader, size: int, stop: Trigger) -> Iterator[FrameBatch]:
    """Yield the frames of a log in batches of at most ``size``, until told to stop."""
    for batch in reader:
        for start in range(0, len(batch), size):
            if stop.is_set:
                return
            yield batch[start : start + size]


def _record(plan: Plan, account: Account, reader: LogReader, output: Path) -> JsonObject:
    """Return everything that is to be said as one JSON object."""
    return {
        **account_record(account),
        "path": str(plan.log),
        "format": reader.format.value,
        "evidence": reader.evidence,
        "output": str(output),
        "layout": plan.layout,
        "values": plan.values.value,
    }


def _show(plan: Plan, account: Account, reader: LogReader, output: Path) -> None:
    """Say the same to people."""
    lines = [
        f"{plan.log}: {reader.format.value}, {account.log.frames} frames: {', '.join(frame_texts(account))}",
        f"taken for {reader.format.value}: {reader.evidence}",
        f"{account.row_count} rows in {output}: {values_text(account)}",
        *losses(account),
        *remarks(account),
    ]
    console = PeopleConsole()
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
