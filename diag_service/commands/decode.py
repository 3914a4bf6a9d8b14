"""``diag-service decode``: what became of logs that are written as tables, for people and as JSON."""

import sys
from collections.abc import Mapping
from contextlib import closing
from typing import Final

from canlog.tables.account import account_record, frame_texts, losses, remarks, values_text
from canlog.tables.decoding import DecodedLogs
from clutch_results.records import dump
from clutchdiag_io.command_line import STANDARD_STREAM
from clutchdiag_io.console import PeopleConsole
from diag_service.api.decoding import TableDone, arranged, decode_each, decode_together, place_of
from diag_service.batch.drives import LeftOut, left_out_record
from diag_service.console import ReadingLine
from diag_service.settings.options import DecodeOptions
from diag_service.stopping import Controls
from fleet_contract import JsonObject

NOTHING_KNOWN: Final = "is it the right database? Try diag-service signals LOG --dbc FILE, which lists what it finds"


def decode(options: DecodeOptions, controls: Controls) -> None:
    """Decode logs into one table, or into tables of each log."""
    options, is_each_alone = arranged(options)
    if not is_each_alone:
        with ReadingLine() as line:
            decode_together(options, controls, line, lambda decoded: _tell(options, decoded))
        return
    console = PeopleConsole()
    with closing(decode_each(options, controls)) as run:
        for news in run:
            if options.json:
                if not isinstance(news, Mapping):
                    _print_record(_record_of_one(news, options))
            elif isinstance(news, TableDone):
                console.print_all((news.line, *(f"  {loss}" for loss in news.losses)))
            elif isinstance(news, Mapping):
                console.print(f"{news['done']} tables in {options.output}, {news['failed']} logs could not be read")


def _tell(options: DecodeOptions, decoded: DecodedLogs) -> None:
    if options.json:
        _print_record(_record(options, decoded))
    else:
        _show(options, decoded, PeopleConsole(stderr=options.output == STANDARD_STREAM))


def _print_record(record: JsonObject) -> None:
    sys.stdout.write(dump(record) + "\n")
    sys.stdout.flush()


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
        share = f": {fates}" if len(decoded.readers) == 1 else ""
        lines.append(f"{reader.name}: {reader.format.value}, {reader.counts.frames} {reader.format.content}{share}")
        lines.append(f"taken for {reader.format.value}: {reader.evidence}")
    content = " and ".join(sorted({reader.format.content for reader in decoded.readers}))
    lines += [f"{account.log.frames} {content}: {fates}"] if len(decoded.readers) > 1 else []
    lines += [f"{account.row_count} rows in {place_of(options)}: {values_text(account)}"]
    hint = [NOTHING_KNOWN] if account.knows_nothing else []
    for line in (*lines, *losses(account), *remarks(account), *hint):
        console.print(line)


def _record_of_one(news: TableDone | LeftOut, options: DecodeOptions) -> JsonObject:
    if isinstance(news, LeftOut):
        return left_out_record(news)
    return {**news.record, "layout": options.layout, "values": options.values}
