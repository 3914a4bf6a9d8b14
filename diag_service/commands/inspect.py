"""``diag-service inspect`` and ``signals``: what a log holds, whatever it means, and a profile proposed from it."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from canlog.files import is_folder
from canlog.frames import EXTENDED_FLAG
from canlog.logs import STANDARD_INPUT
from canlog.logs.log_counts import assumed_texts, lost_texts
from canlog.traffic import MAX_IDS, NS_PER_S, IdTraffic, TrafficReport
from clutch_results.records import dump, utc_from_bus_ns
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.people import SHORT_PLUS_MINUS, STDS, digits
from diag_service.api.logs import FolderContent, Inspection, LinkErrors, TableValues, inspect_logs, profile_for
from diag_service.batch.drives import LeftOut, left_out_record
from diag_service.console import ReadingLine
from diag_service.errors import ConfigError, StoppedError
from diag_service.settings.options import InspectOptions, SignalsOptions
from diag_service.stopping import Controls

MS_PER_S = 1e3
_COLUMNS = "{:>3} {:<8} {} {:>8} {:>5} {:>8} {:>9} {:>9} {:>5} {:>9}"
_VALUE_COLUMNS = "{} {:>8} {:>8} {:>8} {:>9} {:>9} {:>8} {:>9} {:>10} {:>10}"
_VALUE_HEAD = ("unit", "values", "rate Hz", "period ms", SHORT_PLUS_MINUS, "changes", "step", "lowest", "highest")
_HEAD = ("frames", "bytes", "rate Hz", "period ms", SHORT_PLUS_MINUS, "gaps", "longest s")


def inspect(options: InspectOptions, controls: Controls) -> None:
    """Inspect one log after the other; raises StoppedError if that was stopped."""
    console = PeopleConsole()
    with ReadingLine() as line:
        for news in inspect_logs(options, controls, line):
            line.clear()
            if isinstance(news, FolderContent):
                _show_folder(news, options, console)
            elif not isinstance(news, Inspection):
                _show_left_out(news, options, console)
            elif options.json:
                sys.stdout.write(news.to_json() + "\n")
            else:
                _show(news, options.bitrate, console)
                if options.dbc is not None and news.why_wrong:
                    console.print(news.why_wrong)
            if isinstance(news, Inspection) and not news.is_whole:
                raise StoppedError("stopped early: the last table covers only a part of the log")


def _show_folder(folder: FolderContent, options: InspectOptions, console: PeopleConsole) -> None:
    if options.json:
        for left in folder.others:
            _show_left_out(left, options, console)
        return
    console.print(f"{folder.path}: {len(folder.logs)} logs, {len(folder.others)} other files")
    logs = (f"  {_on_one_line(log.path)}: taken for {log.format}: {log.evidence}" for log in folder.logs)
    no_logs = (f"  {_on_one_line(left.path)}: no log: {left.reason}" for left in folder.others)
    console.print_all(sorted((*logs, *no_logs)))


def _show_left_out(left: LeftOut, options: InspectOptions, console: PeopleConsole) -> None:
    if options.json:
        sys.stdout.write(dump(left_out_record(left)) + "\n")
    else:
        console.print(f"{_on_one_line(left.path)}: not a log after all: {left.reason}")


def _on_one_line(path: Path) -> str:
    return str(path).replace("\n", "\\n")


def _show(inspection: Inspection, bitrate: int, console: PeopleConsole) -> None:
    console.print_all(_head(inspection, bitrate))
    if inspection.values is not None:
        console.print_all(_column_lines(inspection.traffic, inspection.values))
        return
    width = max([len(name) for name in inspection.names.values()], default=0)
    console.print(_COLUMNS.format("bus", "id", "message".ljust(width), *_HEAD), style="bold")
    for traffic in inspection.traffic.ids:
        console.print(_COLUMNS.format(*_row(traffic, inspection.names.get(traffic.can_id, "").ljust(width))))
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
    columns = sorted(
        ((values.of(traffic_of_id.can_id), traffic_of_id) for traffic_of_id in traffic.ids),
        key=lambda pair: pair[0].name,
    )
    width = max(len(column.name) for column, _ in columns)
    yield _VALUE_COLUMNS.format("column".ljust(width), *_VALUE_HEAD)
    for column, traffic_of_id in columns:
        yield _VALUE_COLUMNS.format(
            column.name.ljust(width),
            column.unit or "-",
            str(column.count),
            *_interval_cells(traffic_of_id),
            str(column.changes),
            digits(column.step),
            digits(column.lowest),
            digits(column.highest),
        )


def _row(traffic: IdTraffic, name: str) -> tuple[str, ...]:
    is_extended = bool(traffic.can_id & EXTENDED_FLAG)
    identifier = f"{traffic.can_id & 0x1FFF_FFFF:08X}" if is_extended else f"{traffic.can_id & 0x1FFF_FFFF:03X}"
    return (
        str(traffic.channel),
        identifier,
        name,
        str(traffic.count),
        str(traffic.length),
        *_interval_cells(traffic),
        str(traffic.gap_count),
        digits(traffic.longest_gap_s) if traffic.gap_count else "-",
    )


def _interval_cells(traffic: IdTraffic) -> tuple[str, str, str]:
    """Return rate, interval and how far intervals scatter, if any is known."""
    values = (traffic.rate_hz, traffic.period_s * MS_PER_S, STDS * traffic.jitter_s * MS_PER_S)
    rate, period, spread = map(digits, values) if traffic.rate_hz > 0.0 else "---"
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


def signals(options: SignalsOptions, controls: Controls) -> None:
    """Write a profile for a log whose comments say what there is; of a folder or several logs what each can tell."""
    path, *others = options.logs
    as_rows = bool(others) or options.json or options.csv or options.vehicle_from is not None
    if as_rows or (path != STANDARD_INPUT and is_folder(path)):
        from diag_service.commands.reaches import show  # noqa: PLC0415 - one log needs none of it

        show(options, controls)
        return
    if len(options.dbc) > 1:
        raise ConfigError("a profile is proposed for one log and one database: name one, or a folder of logs")
    with ReadingLine() as line:
        text = profile_for(path, next(iter(options.dbc), None), options.columns, controls, line)
    sys.stdout.write(text)
