"""Tables for people, JSON lines for programs."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Final, TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

Record = Mapping[str, object]
Cell = Callable[[Record], str]
_NONE: Final = "-"
_ANY_WIDTH: Final = 200
_STYLES: Final = {"change_fluid": "bold red", "watch": "yellow", "good": "green"}


def write_json(records: Sequence[Record], out: TextIO) -> None:
    """Write one line per record."""
    out.writelines(json.dumps(record, default=_as_text) + "\n" for record in records)


def fleet_table(records: Sequence[Record]) -> Table:
    """Return the clutches of the fleet, worst first, with intervals of two standard deviations and what is wrong."""
    table = _table(
        f"Fleet, worst first: {len(records)} clutches; ± two standard deviations, slope in 1e-3 s/rad",
        records,
        {
            "vehicle": _plain("vehicle"),
            "clutch": _plain("clutch"),
            "condition": lambda record: _condition(record["condition"]),
            "slope": _interval("slope_s_rad", "slope_high_s_rad", "{:+.2f}", scale=1e3),
            "P < 0": _number("probability_negative_slope", "{:.3f}"),
            "mu_C": _interval("mu_c", "mu_c_high", "{:.3f}"),
            "mu_S": _interval("mu_s", "mu_s_high", "{:.3f}"),
            "shifts": _plain("shift_count"),
            "km": _number("odometer_m", "{:.0f}", scale=1e-3),
            "fluid": _plain("fluid"),
            "last shift": _moment("end_at", "%Y-%m-%d"),
        },
    )
    reasons = [_reason(record) for record in records if record["condition"] != "good"]
    table.caption, table.caption_justify = "\n".join(reasons) or None, "left"
    return table


def trend_table(title: str, records: Sequence[Record]) -> Table:
    """Return the estimates of a clutch, one shift per line."""
    return _table(
        title,
        records,
        {
            "shift": _plain("shift_number"),
            "km": _number("odometer_m", "{:.1f}", scale=1e-3),
            "end (UTC)": _moment("end_at"),
            "mu_C": _spread("mu_c", "random_std_mu_c"),
            "mu_S": _spread("mu_s", "random_std_mu_s"),
            "running mu_C": _spread("running_mu_c", "running_std_mu_c"),
            "running mu_S": _spread("running_mu_s", "running_std_mu_s"),
            "condition": lambda record: _condition(record["condition"]),
            "fluid": _plain("fluid"),
            "algorithm": _plain("algorithm_version"),
        },
    )


def alarm_table(clutches: Sequence[Record], identities: Sequence[Record]) -> Table:
    """Return all alarms; those of clutches before those of strangers."""
    rows: list[Record] = [{**record, "kind": "change fluid"} for record in clutches]
    rows += [{**record, "kind": f"identity ({record['message_count']} messages)"} for record in identities]
    return _table(
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
    )


def quarantine_table(records: Sequence[Record]) -> Table:
    """Return what was kept aside."""
    return _table(
        f"Quarantine: the latest {len(records)}",
        records,
        {
            "received (UTC)": _moment("received_at"),
            "vehicle": _plain("vehicle"),
            "reason": _plain("reason"),
            "bytes": _plain("size_bytes"),
            "detail": _plain("detail"),
        },
    )


def seen_table(records: Sequence[Record]) -> Table:
    """Return when each vehicle was heard of."""
    return _table(
        f"Vehicles: {len(records)}, the longest silence first",
        records,
        {
            "vehicle": _plain("vehicle"),
            "service": lambda record: {None: _NONE, True: "online", False: "offline"}[_truth(record["is_online"])],
            "since (UTC)": _moment("connected_at"),
            "last result": _moment("last_result_at"),
            "metrics": _moment("metrics_at"),
            "version": _plain("service_version"),
        },
    )


def show(table: Table, out: TextIO) -> None:
    """Print a table; wide enough for every column where nobody watches and nobody says how wide."""
    console = Console(file=out)
    is_known = console.is_terminal or "COLUMNS" in os.environ
    Console(file=out, width=console.width if is_known else _ANY_WIDTH).print(table)


def _table(title: str, records: Sequence[Record], columns: Mapping[str, Cell]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for name in columns:
        table.add_column(name, overflow="fold")
    for record in records:
        table.add_row(*(cell(record) for cell in columns.values()))
    return table


def _plain(name: str) -> Cell:
    return lambda record: _NONE if record.get(name) is None else escape(str(record[name]))


def _number(name: str, form: str, *, scale: float = 1.0) -> Cell:
    def cell(record: Record) -> str:
        value = record.get(name)
        return form.format(value * scale) if isinstance(value, int | float) else _NONE

    return cell


def _interval(name: str, high: str, form: str, *, scale: float = 1.0) -> Cell:
    def cell(record: Record) -> str:
        value, end = record.get(name), record.get(high)
        if not isinstance(value, int | float) or not isinstance(end, int | float):
            return _NONE
        return f"{form.format(value * scale)} ± {form.replace('+', '').format((end - value) * scale)}"

    return cell


def _spread(name: str, std: str) -> Cell:
    def cell(record: Record) -> str:
        if record.get(name) is None:
            return _NONE
        return f"{_number(name, '{:.4f}')(record)} ± {_number(std, '{:.4f}')(record)}"

    return cell


def _moment(name: str, form: str = "%Y-%m-%d %H:%M:%S") -> Cell:
    def cell(record: Record) -> str:
        value = record.get(name)
        return value.strftime(form) if isinstance(value, datetime) else _NONE

    return cell


def _condition(value: object) -> str:
    text = str(value)
    style = _STYLES.get(text)
    name = text.replace("_", " ")
    return f"[{style}]{name}[/]" if style else name


def _reason(record: Record) -> str:
    return escape(f"{record['vehicle']}, clutch {record['clutch']}: {record['condition_reason']}")


def _truth(value: object) -> bool | None:
    return None if value is None else bool(value)


def _as_text(value: object) -> str:
    if isinstance(value, datetime):
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} has no place in JSON")
