"""Tables for people, a line per record; JSON lines for programs."""

import json
from collections.abc import Callable, Mapping, Sequence
from datetime import date, datetime
from types import MappingProxyType
from typing import Final, TextIO

from rich.table import Table
from rich.text import Text

from clutchdiag_io.console import plain_table
from clutchdiag_io.people import PER_1000_RPM, PLUS_MINUS, SLOPE_UNIT, STDS, km_words, moment_words

NONE: Final = "-"

Record = Mapping[str, object]
Cell = Callable[[Record], str]
_SERVICES: Final[Mapping[object, str]] = {None: NONE, True: "online", False: "offline"}
_STYLES: Final = MappingProxyType({"change fluid": "bold red", "watch": "yellow", "good": "green"})


def write_json(records: Sequence[Record], out: TextIO) -> None:
    out.writelines(json.dumps(record, default=_as_text) + "\n" for record in records)


def fleet_table(records: Sequence[Record]) -> Table:
    """Return the clutches of the fleet, worst first, with intervals of two standard deviations and what is wrong."""
    return _sheet(
        f"Fleet, worst first: {len(records)} clutches; {PLUS_MINUS}, slope {SLOPE_UNIT}; km at least: 90 % sure",
        records,
        {
            "vehicle": _plain("vehicle"),
            "clutch": lambda record: str(record["element"] or record["clutch"]),
            "tier": _plain("tier"),
            "condition": _condition,
            "slope": _interval("slope_s_rad", "slope_high_s_rad", "{:+.3f}", scale=PER_1000_RPM),
            "P<0": _number("probability_negative_slope", "{:.3f}"),
            "mu_C": _interval("mu_c", "mu_c_high", "{:.3f}"),
            "mu_S": _interval("mu_s", "mu_s_high", "{:.3f}"),
            "shifts": _plain("shift_count"),
            "km": _number("odometer_m", "{:.0f}", scale=1e-3),
            "km left": _km_left,
            "fluid": _plain("fluid"),
            "last shift": _moment("end_at", "%Y-%m-%d"),
            "reason": lambda record: NONE if record["action"] == "nothing" else str(record["order"]),
        },
    )


def trend_table(title: str, records: Sequence[Record]) -> Table:
    """Return the estimates of a clutch, one shift per line."""
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
    )


def alarm_table(raised: Sequence[Record], identities: Sequence[Record]) -> Table:
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
    )


def quarantine_table(records: Sequence[Record]) -> Table:
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
    )


def seen_table(records: Sequence[Record]) -> Table:
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
    )


def partition_table(records: Sequence[Record]) -> Table:
    return _sheet(
        f"Partitions: {len(records)}",
        records,
        {
            "partition": _plain("name"),
            "month": lambda record: NONE if record["month"] is None else f"{record['month']:%Y-%m}",
            "results, about": _plain("row_estimate"),
            "MiB": _number("size_bytes", "{:.1f}", scale=2.0**-20),
        },
    )


def usual_table(records: Sequence[Record], clutch_count: int, left_out_count: int) -> Table:
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
    )


def codes_table(records: Sequence[Record]) -> Table:
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
    )


def _texts(value: object) -> list[str]:
    return [str(part) for part in value] if isinstance(value, list) else []


def _sheet(title: str, records: Sequence[Record], columns: Mapping[str, Cell]) -> Table:
    table = plain_table(columns, columns, title)
    for record in records:
        texts = [_one_line(cell(record)) for cell in columns.values()]
        table.add_row(*(Text(text, _STYLES.get(text, "")) for text in texts))
    return table


def _one_line(text: str) -> str:
    """Return a text on one line that no terminal takes for more than a text."""
    shown = "".join(char if char.isprintable() or char.isspace() else ascii(char)[1:-1] for char in text)
    return " ".join(shown.split())


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


def _km_left(record: Record) -> str:
    left_m, least_m = record.get("left_m"), record.get("least_left_m")
    if isinstance(left_m, float):
        return f"{left_m / 1000.0:,.0f}"
    return f"at least {km_words(least_m)}" if isinstance(least_m, float) else NONE


def _condition(record: Record) -> str:
    return str(record["condition"]).replace("_", " ")


def _as_text(value: object) -> str:
    if isinstance(value, date):  # or a moment
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} has no place in JSON")
