"""Every file that ``decode`` can write of random databases and logs, as two libraries and cantools read it."""

import json
import math
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion
from cantools.database.namedsignalvalue import NamedSignalValue

from canlog.column_files import SUFFIX_OF_FORMAT, TableFormat
from canlog.tables.decoding import Plan, TableShape, decode_logs
from canlog.tables.layouts import Values
from tests.support.cantools_oracle import readings
from tests.support.random_log import SentFrame, random_frames, write_candump

Row = dict[str, Any]
Cell = tuple[float | None, str | None]
UNITS: Final = ("", "", "rpm", "°C", "km/h")
TEXTS: Final = ("Off", "on, running", 'a "word"', "Grüße", "true", "1.5", "NULL", "SNA")
FRAME_COLUMNS: Final = ("time", "channel", "id", "is_extended", "message")
LEAST_PAYLOADS: Final = 4


@dataclass(frozen=True, slots=True)
class Case:
    """A database, a log and a way to write it."""

    messages: list[Message]
    frames: list[SentFrame]
    written: Values
    group_rows: int  # at most in a group of rows


@dataclass(frozen=True, slots=True)
class Sent:
    """A frame and what cantools says of it: the cells of its signals, in their order."""

    known: tuple[int, int, int, bool, str]  # FRAME_COLUMNS
    cells: Mapping[str, Cell]  # of the signals that it carries
    units: Mapping[str, str]


@dataclass(slots=True)
class Findings:
    """What was compared, and what is wrong."""

    files: Counter[str] = field(default_factory=Counter)
    cells: int = 0
    wrong: list[str] = field(default_factory=list)


def random_case(seed: int) -> Case:
    """Return the case of a number."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    alike = rng.random() < 0.2  # messages share a name
    can_ids = rng.choice(0x600, count, replace=False).tolist()
    unit = str(rng.choice(UNITS)) if rng.random() < 0.5 else None  # all signals share it
    messages = [_message(rng, can_id, "Same" if alike else f"M{place}", unit) for place, can_id in enumerate(can_ids)]
    frames = random_frames(messages, int(rng.integers(LEAST_PAYLOADS, 20)), rng)
    if rng.random() < 0.3:  # messages that come one after the other: what a group of rows holds is often all alike
        frames.sort(key=lambda one: one.place)
    values = list(Values)[int(rng.integers(len(Values)))]
    return Case(messages, frames, values, int(rng.choice([1, 3, 10, 100_000])))


def _message(rng: np.random.Generator, can_id: int, name: str, unit: str | None) -> Message:
    is_fd, is_extended = bool(rng.random() < 0.15), bool(rng.random() < 0.3)
    length = int(rng.choice([12, 20, 64])) if is_fd else int(rng.integers(1, 9))
    signals: list[Signal] = []
    bit, is_paged = 0, length > 1 and bool(rng.random() < 0.25)
    if is_paged:
        conversion = BaseConversion.factory()
        signals.append(Signal("Page", 0, 2, conversion=conversion, is_multiplexer=True))
        bit = 8
    while bit < 8 * length and len(signals) < 6:
        signal, bit = _signal(rng, f"S{len(signals)}", bit, 8 * length - bit, unit)
        if is_paged and rng.random() < 0.7:
            signal.multiplexer_ids, signal.multiplexer_signal = [int(rng.integers(3))], "Page"
        signals.append(signal)
    return Message(can_id, name, length, signals, is_extended_frame=is_extended, is_fd=is_fd)


def _signal(rng: np.random.Generator, name: str, bit: int, room: int, unit: str | None) -> tuple[Signal, int]:
    """Return a signal from a bit on, and the bit behind it; big-endian ones and floats are whole bytes."""
    sort = rng.random()
    own_unit = str(rng.choice(UNITS)) if unit is None else unit
    whole = [size for size in (32, 64) if size <= room - (-bit % 8)]
    if sort < 0.15 and whole:
        start = bit + (-bit % 8)
        length = int(rng.choice(whole))
        scale, offset = float(rng.choice([1.0, 0.1])), 0.0
        conversion = BaseConversion.factory(scale=scale, offset=offset, is_float=True)
        return Signal(name, start, length, conversion=conversion, unit=own_unit), start + length
    length = int(rng.integers(1, min(room, 64) + 1)) if sort > 0.5 else min(room, int(rng.integers(1, 17)))
    is_big = length >= 8 and room - (-bit % 8) >= 8 and bool(rng.random() < 0.4)
    start, end = bit, bit + length
    if is_big:
        first = bit + (-bit % 8)
        length = (min(length, room - (first - bit)) // 8) * 8
        start, end = first + 7, first + length
    scale, offset = rng.choice([1.0, 2.0, 0.1, 0.00390625, -0.5]), rng.choice([0.0, -40.0, 0.3])
    choices: OrderedDict[int, str | NamedSignalValue] | None = None
    if rng.random() < 0.35:
        raws = rng.choice(min(1 << length, 256), min(3, 1 << length), replace=False).tolist()
        choices = OrderedDict((raw, NamedSignalValue(raw, str(rng.choice(TEXTS)))) for raw in raws)
    signal = Signal(
        name,
        start,
        length,
        byte_order="big_endian" if is_big else "little_endian",
        is_signed=bool(rng.random() < 0.3) and choices is None,
        conversion=BaseConversion.factory(scale=float(scale), offset=float(offset), choices=choices),
        unit=own_unit or None,
    )
    return signal, end


def compare(case: Case, folder: Path) -> Findings:
    """Write a case in every layout and format, and compare what two libraries read of each file."""
    findings = Findings()
    log = folder / "random.log"
    write_candump(log, case.messages, case.frames)
    whole = Plan.of(case.messages, values=case.written)
    sent = list(_sent(case, whole))
    for table_format in TableFormat:
        for shape in TableShape:
            plan = Plan(
                codec=whole.codec,
                names=whole.names,
                shape=shape,
                values=case.written,
                max_cells=8 * case.group_rows,
                max_frames=case.group_rows,
                max_values=8 * case.group_rows,
            )
            output = folder / f"{shape}-{table_format}{SUFFIX_OF_FORMAT[table_format]}"
            decode_logs([log], plan, output, table_format)
            for name, reader in READERS[table_format].items():
                label = f"{shape} {table_format} by {name}"
                findings.files[label] += 1
                try:
                    _judge(findings, label, sent, plan, output, reader, table_format)
                except Exception as error:  # noqa: BLE001 - whatever a library says of a file that it cannot read
                    findings.wrong.append(f"{label}: {type(error).__name__}: {error}")
    return findings


def _sent(case: Case, plan: Plan) -> Iterator[Sent]:
    found = []
    for place, table in enumerate(plan.codec.tables):
        own = [number for number, frame in enumerate(case.frames) if frame.place == place]
        payloads = [case.frames[number].payload for number in own]
        columns = readings(table.message, table.definitions, payloads)
        units = {name: signal.unit or "" for name, signal in table.definitions.items()}
        message, name = table.message, plan.names.messages[place]
        for row, number in enumerate(own):
            known = (10**9 + number * 1000, 0, message.frame_id, message.is_extended_frame, name)
            cells = {
                signal: (float(one.number[row]), one.text[row])
                for signal, one in columns.items()
                if one.is_there[row] and signal in table.signals
            }
            found.append((number, Sent(known, cells, units)))
    yield from (sent for _, sent in sorted(found, key=lambda one: one[0]))


def _judge(
    findings: Findings,
    label: str,
    sent: Sequence[Sent],
    plan: Plan,
    output: Path,
    reader: "Reader",
    table_format: TableFormat,
) -> None:
    has_nan = table_format is not TableFormat.JSON_LINES
    is_one = plan.shape is TableShape.WIDE
    wanted = [(*one.known, _cells_of(one, plan, has_nan=has_nan)) for one in sent]
    rows = reader(output) if is_one else [row for path in sorted(output.iterdir()) for row in reader(path)]
    found = [(*_known(row), _cells_in(row, plan, has_nan=has_nan, has_message=is_one)) for row in rows]
    if not is_one:
        found.sort(key=lambda row: int(str(row[0])))
    findings.cells += len(wanted)
    if found != wanted:
        places = [place for place, (one, other) in enumerate(zip(found, wanted, strict=False)) if one != other]
        first = places[0] if places else min(len(found), len(wanted))
        findings.wrong.append(
            f"{label}: {len(found)} rows for {len(wanted)}, first difference in row {first}: "
            f"{found[first : first + 1]} for {wanted[first : first + 1]}"
        )


def _known(row: Row) -> tuple[object, ...]:
    return tuple(row[name] for name in FRAME_COLUMNS)


def _written(cell: Cell, values: Values, *, has_nan: bool) -> tuple[object, object]:
    number, text = cell
    if values is Values.NUMBERS:
        return _number(number, has_nan=has_nan), None
    if values is Values.TEXTS and text is not None:
        return None, text
    return _number(number, has_nan=has_nan), text


def _cells_of(one: Sent, plan: Plan, *, has_nan: bool) -> tuple[tuple[str, object, object], ...]:
    cells = ((name, *_written(cell, plan.values, has_nan=has_nan)) for name, cell in one.cells.items())
    return tuple(cell for cell in cells if cell[1:] != (None, None))


def _cells_in(row: Row, plan: Plan, *, has_nan: bool, has_message: bool) -> tuple[tuple[str, object, object], ...]:
    """Return the cells of a row; any of another message is one that nobody wants, and keeps its column's name."""
    slot = plan.names.messages.index(row["message"])
    names = plan.names if has_message else plan.names.of_message(slot, FRAME_COLUMNS)
    own = {column: name for (owner, name), column in names.columns.items() if owner == slot}
    cells = []
    for column in names.columns.values():
        if not has_message and column not in own:
            continue
        number, text = _number(row.get(column), has_nan=has_nan), row.get(f"{column}.text")
        if (number, text) != (None, None):
            cells.append((own.get(column, column), number, text))
    return tuple(cells)


def _number(value: object, *, has_nan: bool) -> str | None:
    """Return a number by its bits; a format without them has nothing for numbers that are none."""
    if value is None or value == "":
        return None
    number = float(str(value)) if isinstance(value, str) else float(value)  # type: ignore[arg-type]  # any number
    if not math.isfinite(number) and not has_nan:
        return None
    return "nan" if math.isnan(number) else number.hex()


Reader = Callable[[Path], list[Any]]


def _of_arrow(table: pa.Table) -> list[Row]:
    place = table.schema.get_field_index("time")
    return list(table.set_column(place, "time", table["time"].cast(pa.int64())).to_pylist())


def _of_polars(table: pl.DataFrame) -> list[Row]:
    return table.with_columns(pl.col("time").to_physical()).to_dicts()


def _of_texts(rows: Sequence[Row]) -> list[Row]:
    """Return rows of a format of texts with the types of the frames' columns."""
    typed = []
    for row in rows:
        own = {name: cell for name, cell in row.items() if cell not in {None, ""}}
        own |= {"unit": own.get("unit", ""), "value": own.get("value")}
        own["time"] = _nanoseconds(row["time"])
        own["channel"], own["id"] = int(row["channel"]), int(row["id"])
        own["is_extended"] = row["is_extended"] in {True, "true"}
        typed.append(own)
    return typed


def _nanoseconds(text: str) -> int:
    whole, part = text.removesuffix("Z").split(".")
    return int(datetime.fromisoformat(whole).replace(tzinfo=UTC).timestamp()) * 10**9 + int(part)


def _csv_by_arrow(path: Path) -> list[Row]:
    names = pyarrow.csv.open_csv(path).schema.names
    texts = pyarrow.csv.ConvertOptions(column_types={name: pa.string() for name in names})
    parse = pyarrow.csv.ParseOptions(newlines_in_values=True)
    return _of_texts(pyarrow.csv.read_csv(path, convert_options=texts, parse_options=parse).to_pylist())


def _csv_by_pandas(path: Path) -> list[Row]:
    rows: list[Row] = pd.read_csv(path, dtype=str, keep_default_na=False).to_dict("records")
    return _of_texts(rows)


def _lines_by_json(path: Path) -> list[Row]:
    return _of_texts([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()])


def _lines_by_polars(path: Path) -> list[Row]:
    if not path.stat().st_size:
        return []
    return _of_texts(pl.read_ndjson(path, infer_schema_length=None).to_dicts())


READERS: Final[Mapping[TableFormat, Mapping[str, Reader]]] = MappingProxyType(
    {
        TableFormat.PARQUET: {
            "pyarrow": lambda path: _of_arrow(pq.read_table(path)),
            "polars": lambda path: _of_polars(pl.read_parquet(path)),
        },
        TableFormat.CSV: {"pyarrow": _csv_by_arrow, "pandas": _csv_by_pandas},
        TableFormat.JSON_LINES: {"json": _lines_by_json, "polars": _lines_by_polars},
        TableFormat.ARROW: {
            "pyarrow": lambda path: _of_arrow(pa.ipc.open_stream(path).read_all()),
            "polars": lambda path: _of_polars(pl.read_ipc_stream(path)),
        },
    }
)
