"""Tables for people, laid out so that no word is broken and no row loses whom it is about; JSON lines for programs.

Without a width, in a pipe, every record is one line. Where a table is too wide for a terminal, texts are wrapped
between words; then columns that can be done without go, and are named; in the end each record is a block with a value
per line, as psql's expanded display has it.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime
from itertools import zip_longest
from types import MappingProxyType
from typing import Final, TextIO

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from clutchdiag_io.people import PER_1000_RPM, PLUS_MINUS, SLOPE_UNIT, STDS, moment_words

_GAP: Final = 2  # spaces between columns; inside a text there is never more than one
_NARROW_GAP: Final = 1
_RULE: Final = "─"
NONE: Final = "-"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """What is to be shown: texts in rows."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    dispensable: Sequence[str] = ()  # columns that go where there is no room, in this order
    remarks: Sequence[tuple[str, str]] | None = None  # of each row: whom it is about, what is told of it
    styles: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))  # of a text that is a whole cell


@dataclass(frozen=True, slots=True)
class _Grid:
    """Rows, their head first, and how wide each column is."""

    rows: Sequence[Sequence[str]]
    widths: Sequence[int]
    gap: int


def lines_of(sheet: Sheet, width: int | None) -> Iterator[Text]:
    """Yield the lines of a sheet, none longer than ``width`` unless a single word is; None: a line per record."""
    rows = [list(sheet.columns), *([plain(text) for text in row] for row in sheet.rows)]
    remarks = [(whom, plain(text)) for whom, text in sheet.remarks or ()]
    if width is None:
        if sheet.remarks is not None:
            last = ["reason", *(text or NONE for _, text in remarks)]
            rows = [[*row, text] for row, text in zip(rows, last, strict=True)]
        yield Text(plain(sheet.title))
        widths = _natural(rows)
        yield from (Text(_joined(row, widths, _GAP)) for row in rows)
        return
    yield from (Text(line) for line in wrapped(sheet.title, width))
    kept, gone = _enough_columns(sheet, rows, width)
    if kept is None:
        yield from _blocks(rows, remarks, sheet.styles, width)
        return
    yield from _table(kept, sheet.styles)
    if gone:
        told = f"Hidden at this width: {', '.join(gone)}. A wider terminal, a pipe or --json shows all."
        yield from (Text(line, "dim") for line in wrapped(told, width))
    for whom, text in dict.fromkeys(remarks):  # clutches of one vehicle have one order
        if text:
            yield from (Text(line, "italic") for line in wrapped(f"{whom}: {text}", width))


def plain(text: str) -> str:
    """Return a text on one line that no terminal takes for more than a text."""
    shown = "".join(char if char.isprintable() or char.isspace() else ascii(char)[1:-1] for char in text)
    return " ".join(shown.split())


def wrapped(text: str, width: int) -> list[str]:
    """Return the lines of a text, broken between words only."""
    lines: list[str] = []
    for word in text.split():
        if lines and cell_len(lines[-1]) + 1 + cell_len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines or [""]


def _enough_columns(sheet: Sheet, rows: Sequence[Sequence[str]], width: int) -> tuple[_Grid | None, Sequence[str]]:
    """Return the table with as many columns as fit, and the names of the others; None where too few fit."""
    for count in range(len(sheet.dispensable) + 1):
        gone = sheet.dispensable[:count]
        kept = [[text for name, text in zip(sheet.columns, row, strict=True) if name not in gone] for row in rows]
        for gap in (_GAP, _NARROW_GAP):
            widths = _wrapped_widths(kept, width - gap * (len(kept[0]) - 1))
            if widths is not None:
                return _Grid(kept, widths, gap), gone
    return None, ()


def _wrapped_widths(rows: Sequence[Sequence[str]], room: int) -> list[int] | None:
    """Return the widths of columns that are wrapped as little as is needed; None if they do not fit."""
    widths = _natural(rows)
    least = [
        max(cell_len(word) for text in column for word in text.split() or [""]) for column in zip(*rows, strict=True)
    ]
    if sum(least) > room:
        return None
    while sum(widths) > room:
        slack = [have - need for have, need in zip(widths, least, strict=True)]
        widths[slack.index(max(slack))] -= 1
    return widths


def _natural(rows: Sequence[Sequence[str]]) -> list[int]:
    return [max(cell_len(text) for text in column) for column in zip(*rows, strict=True)]


def _joined(texts: Sequence[str], widths: Sequence[int], gap: int) -> str:
    cells = (text + " " * (width - cell_len(text)) for text, width in zip(texts, widths, strict=True))
    return (" " * gap).join(cells).rstrip()


def _table(grid: _Grid, styles: Mapping[str, str]) -> Iterator[Text]:
    head, *rows = grid.rows
    for line in _row_lines(grid, head, {}):
        line.stylize("bold")
        yield line
    yield Text(_RULE * (sum(grid.widths) + grid.gap * (len(grid.widths) - 1)))
    for row in rows:
        yield from _row_lines(grid, row, styles)


def _row_lines(grid: _Grid, row: Sequence[str], styles: Mapping[str, str]) -> Iterator[Text]:
    """Yield the lines of one record, its texts wrapped to their columns."""
    columns = [wrapped(text, width) for text, width in zip(row, grid.widths, strict=True)]
    for parts in zip_longest(*columns, fillvalue=""):
        line, begin = Text(_joined(parts, grid.widths, grid.gap)), 0
        for text, part, width in zip(row, parts, grid.widths, strict=True):
            if style := styles.get(text):
                line.stylize(style, begin, begin + len(part))
            begin += len(part) + width - cell_len(part) + grid.gap
        yield line


def _blocks(
    rows: Sequence[Sequence[str]], remarks: Sequence[tuple[str, str]], styles: Mapping[str, str], width: int
) -> Iterator[Text]:
    """Yield every record as a block: a name and a value per line."""
    names, *records = rows
    indent = max(cell_len(name) for name in (*names, "reason")) + _GAP
    for record, (_, remark) in zip_longest(records, remarks, fillvalue=("", "")):
        yield Text("")
        pairs = [*zip(names, record, strict=True), *([("reason", remark)] if remark else [])]
        for name, text in pairs:
            first, *others = wrapped(text, max(1, width - indent))
            line = Text(name + " " * (indent - cell_len(name)) + first)
            line.stylize(styles.get(text, ""), indent)
            yield line
            yield from (Text(" " * indent + other) for other in others)


Record = Mapping[str, object]
Cell = Callable[[Record], str]
_SERVICES: Final[Mapping[object, str]] = {None: NONE, True: "online", False: "offline"}
_STYLES: Final = MappingProxyType({"change fluid": "bold red", "watch": "yellow", "good": "green"})


def write_json(records: Sequence[Record], out: TextIO) -> None:
    out.writelines(json.dumps(record, default=_as_text) + "\n" for record in records)


def fleet_table(records: Sequence[Record]) -> Sheet:
    """Return the clutches of the fleet, worst first, with intervals of two standard deviations and what is wrong."""
    return _sheet(
        f"Fleet, worst first: {len(records)} clutches; {PLUS_MINUS}, slope {SLOPE_UNIT}",
        records,
        {
            "vehicle": _plain("vehicle"),
            "clutch": lambda record: str(record["element"] or record["clutch"]),
            "condition": _condition,
            "slope": _interval("slope_s_rad", "slope_high_s_rad", "{:+.3f}", scale=PER_1000_RPM),
            "P<0": _number("probability_negative_slope", "{:.3f}"),
            "mu_C": _interval("mu_c", "mu_c_high", "{:.3f}"),
            "mu_S": _interval("mu_s", "mu_s_high", "{:.3f}"),
            "shifts": _plain("shift_count"),
            "km": _number("odometer_m", "{:.0f}", scale=1e-3),
            "fluid": _plain("fluid"),
            "last shift": _moment("end_at", "%Y-%m-%d"),
        },
        dispensable=("fluid", "km", "shifts", "mu_S", "mu_C", "last shift", "P<0", "slope"),
        remarks=[(str(one["vehicle"]), "" if one["action"] == "nothing" else str(one["order"])) for one in records],
    )


def trend_table(title: str, records: Sequence[Record]) -> Sheet:
    """Return the estimates of a clutch, one shift per line; where fluid was changed each tells which one was in."""
    has_fill = any(record["fluid"] for record in records)
    return _sheet(
        f"{title}; {PLUS_MINUS}",
        records,
        {
            "shift": _plain("shift_number"),
            "km": _number("odometer_m", "{:.0f}", scale=1e-3),
            "end (UTC)": _moment("end_at"),
            "mu_C": _spread("mu_c", "random_std_mu_c"),
            "mu_S": _spread("mu_s", "random_std_mu_s"),
            "running mu_C": _spread("running_mu_c", "running_std_mu_c"),
            "running mu_S": _spread("running_mu_s", "running_std_mu_s"),
            "condition": _condition,
            "fluid": _plain("fluid"),
            "algorithm": _plain("algorithm_version"),
        },
        dispensable=("algorithm", "km", "running mu_S", "running mu_C", "condition", *(() if has_fill else ("fluid",))),
    )


def alarm_table(raised: Sequence[Record], identities: Sequence[Record]) -> Sheet:
    """Return all alarms; those that rules raised before those of strangers."""
    rows: list[Record] = [
        {**record, "kind": record["rule"], "clutch": record["element"] or record["clutch"]} for record in raised
    ]
    rows += [{**record, "kind": f"identity ({record['message_count']} messages)"} for record in identities]
    return _sheet(
        f"Alarms: {len(rows)}",
        rows,
        {
            "alarm": _plain("kind"),
            "vehicle": _plain("vehicle"),
            "clutch": _plain("clutch"),
            "raised (UTC)": _moment("raised_at"),
            "cleared": _moment("cleared_at"),
            "acknowledged": _moment("acknowledged_at"),
            "by": _plain("acknowledged_by"),
            "reason": _plain("reason"),
        },
        dispensable=("by", "cleared", "acknowledged"),
    )


def quarantine_table(records: Sequence[Record]) -> Sheet:
    return _sheet(
        f"Quarantine: the latest {len(records)}",
        records,
        {
            "received (UTC)": _moment("received_at"),
            "vehicle": _plain("vehicle"),
            "reason": _plain("reason"),
            "bytes": _plain("size_bytes"),
            "detail": _plain("detail"),
        },
        dispensable=("bytes",),
    )


def seen_table(records: Sequence[Record]) -> Sheet:
    """Return when each vehicle was heard of."""
    return _sheet(
        f"Vehicles: {len(records)}, the longest silence first",
        records,
        {
            "vehicle": _plain("vehicle"),
            "service": lambda record: _SERVICES[record["is_online"]],
            "since (UTC)": _moment("connected_at"),
            "last result": _moment("last_result_at"),
            "metrics": _moment("metrics_at"),
            "version": _plain("service_version"),
        },
        dispensable=("version", "metrics", "since (UTC)"),
    )


def partition_table(records: Sequence[Record]) -> Sheet:
    return _sheet(
        f"Partitions: {len(records)}",
        records,
        {
            "partition": _plain("name"),
            "month": lambda record: NONE if record["month"] is None else f"{record['month']:%Y-%m}",
            "results, about": _plain("row_estimate"),
            "MiB": _number("size_bytes", "{:.1f}", scale=2.0**-20),
        },
        dispensable=("month",),
    )


def usual_table(records: Sequence[Record], clutch_count: int, left_out_count: int) -> Sheet:
    """Return how fluids of each kind usually age."""
    left_out = f"; {left_out_count} of another calibration are left out" if left_out_count else ""
    return _sheet(
        f"What is usual, learned from {clutch_count} clutches{left_out}; {PLUS_MINUS} between them",
        records,
        {
            "type": _plain("vehicle_type"),
            "fluid": lambda record: str(record["fluid"] or "any"),
            "lives": _plain("life_count"),
            "of new": _plain("channel"),
            "begins at": _number("start", "{:.3f}"),
            "±": _number("start_std", "{:.3f}", scale=STDS),
            "lost in 100,000 km": _number("loss_per_m", "{:.3f}", scale=1e8),
            "± %": _number("loss_log_std", "{:.0f}", scale=100.0 * STDS),
        },
        dispensable=("type",),
    )


def codes_table(records: Sequence[Record]) -> Sheet:
    count = sum(record["code"] is not None for record in records)
    return _sheet(
        f"Trouble codes: {count} of {len({record['vehicle'] for record in records})} vehicles",
        records,
        {
            "vehicle": _plain("vehicle"),
            "code": _plain("code"),
            "state": lambda record: NONE if record["states"] is None else ", ".join(_texts(record["states"])),
            "text": _plain("text"),
            "read (UTC)": _moment("read_at"),
            "controller": _plain("controller"),
        },
        dispensable=("controller", "read (UTC)", "text"),
    )


def _texts(value: object) -> list[str]:
    return [str(one) for one in value] if isinstance(value, list) else []


def show(sheet: Sheet, out: TextIO, width: int | None = None) -> None:
    """Print a sheet: to a terminal as wide as that is, elsewhere as wide as it is, unless a width is asked for."""
    console = _Console(file=out, highlight=False)
    if width is None and console.is_terminal:
        width = console.width
    for line in lines_of(sheet, width):
        console.print(line, soft_wrap=True)


class _Console(Console):
    """A console that lets its owner know of a broken pipe, instead of ending the process."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def _sheet(
    title: str,
    records: Sequence[Record],
    columns: Mapping[str, Cell],
    *,
    dispensable: Sequence[str],
    remarks: Sequence[tuple[str, str]] | None = None,
) -> Sheet:
    rows = [[cell(record) for cell in columns.values()] for record in records]
    return Sheet(
        title=title, columns=list(columns), rows=rows, dispensable=dispensable, remarks=remarks, styles=_STYLES
    )


def _plain(name: str) -> Cell:
    return lambda record: NONE if record.get(name) is None else str(record[name])


def _number(name: str, form: str, *, scale: float = 1.0) -> Cell:
    def cell(record: Record) -> str:
        value = record.get(name)
        return form.format(value * scale) if isinstance(value, int | float) else NONE

    return cell


def _interval(name: str, high: str, form: str, *, scale: float = 1.0) -> Cell:
    def cell(record: Record) -> str:
        value, end = record.get(name), record.get(high)
        if not isinstance(value, int | float) or not isinstance(end, int | float):
            return NONE
        return f"{form.format(value * scale)} ±{form.replace('+', '').format((end - value) * scale)}"

    return cell


def _spread(name: str, std: str) -> Cell:
    def cell(record: Record) -> str:
        if record.get(name) is None:
            return NONE
        return f"{_number(name, '{:.4f}')(record)} ±{_number(std, '{:.4f}', scale=STDS)(record)}"

    return cell


def _moment(name: str, form: str = "%Y-%m-%d %H:%M:%S") -> Cell:
    def cell(record: Record) -> str:
        value = record.get(name)
        return moment_words(value, form) if isinstance(value, datetime) else NONE

    return cell


def _condition(record: Record) -> str:
    return str(record["condition"]).replace("_", " ")


def _as_text(value: object) -> str:
    if isinstance(value, date):  # or a moment
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} has no place in JSON")
