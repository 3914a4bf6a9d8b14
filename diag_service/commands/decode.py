"""``diag-service decode``: the signals of a log as Parquet, streamed through bounded memory."""

import argparse
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dbc.contract import DBC_PATH
from diag_service.columns import FloatArray, Int64Array
from diag_service.decoding.codec import Codec, MessageValues
from diag_service.definitions.database import load_database
from diag_service.errors import ConfigError, StoreError
from diag_service.frames import FrameBatch
from diag_service.notices import NOTICE
from diag_service.parquet_file import NAME_TYPE, TIME_TYPE, ParquetTable, load_pyarrow
from diag_service.sources import read_log
from diag_service.stopping import Trigger

TIME, CHANNEL, MESSAGE, SIGNAL, VALUE, UNIT = "time", "channel", "message", "signal", "value", "unit"
MAX_CELLS = 4_000_000  # of a row group: 32 MB of numbers
CELLS_PER_FRAME = 64  # of the long table, at most as a rule
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Part:
    """Values of one signal in a batch."""

    message: str
    signal: str
    unit: str
    rows: Int64Array  # (n,) of the batch
    value: FloatArray  # (n,)


def execute(options: argparse.Namespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Decode a log; the file appears when it is complete."""
    del counts_wanted
    if options.output.suffix.lower() != ".parquet":
        raise ConfigError(f"{options.output}: the signals are written as .parquet")
    load_pyarrow()
    codec = Codec(load_database(options.dbc or DBC_PATH).messages)
    part = options.output.with_name(f".{options.output.name}.part")
    try:
        decode = decode_wide if options.layout == "wide" else decode_long
        count = decode(options.log, codec, part, stop)
        if stop.is_set:
            return
        part.replace(options.output)
    except OSError as exc:
        raise StoreError(f"cannot write {options.output}: {exc.strerror or exc}") from exc
    finally:
        part.unlink(missing_ok=True)
    _LOG.log(NOTICE, "%d rows in %s", count, options.output)


def decode_wide(log: Path, codec: Codec, output: Path, stop: Trigger) -> int:
    """Write a row per frame of a known message and a column per signal; return the number of rows.

    The log is read twice: first for the messages that occur, which are the columns.
    """
    units = _signals_in(log, codec, stop)
    kinds = {TIME: TIME_TYPE, CHANNEL: "int64", MESSAGE: NAME_TYPE, **dict.fromkeys(units, "float64")}
    count = 0
    with ParquetTable(output, kinds, {name: {UNIT: unit} for name, unit in units.items() if unit}) as table:
        for batch in _pieces(log, max(1, MAX_CELLS // max(1, len(units))), stop):
            found = list(codec.decode(batch))
            if found:
                table.write_columns(_wide(batch, found, codec, units))
                count += sum(len(one.rows) for one in found)
    return count


def decode_long(log: Path, codec: Codec, output: Path, stop: Trigger) -> int:
    """Write a row per value: time, channel, message, signal, value, unit; return the number of rows."""
    kinds = {TIME: TIME_TYPE, CHANNEL: "int64", MESSAGE: NAME_TYPE, SIGNAL: NAME_TYPE, VALUE: "float64"}
    count = 0
    with ParquetTable(output, {**kinds, UNIT: NAME_TYPE}) as table:
        for batch in _pieces(log, MAX_CELLS // CELLS_PER_FRAME, stop):
            parts = [part for found in codec.decode(batch) for part in _parts(found, codec)]
            if parts:
                table.write_columns(_long(batch, parts))
                count += sum(len(part.rows) for part in parts)
    return count


def _wide(batch: FrameBatch, found: Sequence[MessageValues], codec: Codec, units: Mapping[str, str]) -> dict[str, Any]:
    """Return the columns of one row group, in their order."""
    rows = np.concatenate([one.rows for one in found])
    order = np.argsort(rows, kind="stable")
    to_row = np.empty(len(rows), np.int64)
    to_row[order] = np.arange(len(rows))
    values: dict[str, FloatArray] = {}
    start = 0
    for one in found:
        target = to_row[start : start + len(one.rows)]
        start += len(one.rows)
        for name, decoded in one.signals.items():
            column = values[f"{codec.tables[one.slot].message.name}.{name}"] = np.full(len(rows), np.nan)
            column[target] = (
                decoded.value if decoded.is_good is None else np.where(decoded.is_good, decoded.value, np.nan)
            )
    nothing = np.full(len(rows), np.nan)
    names = [codec.tables[one.slot].message.name for one in found]
    return {
        **_frame_columns(batch, rows[order]),
        MESSAGE: _coded(names, [len(one.rows) for one in found], order),
        **{name: _nullable(values.get(name, nothing)) for name in units},
    }


def _long(batch: FrameBatch, parts: Sequence[_Part]) -> dict[str, Any]:
    """Return the columns of one row group, in their order."""
    rows = np.concatenate([part.rows for part in parts])
    order = np.argsort(rows, kind="stable")
    counts = [len(part.rows) for part in parts]
    return {
        **_frame_columns(batch, rows[order]),
        MESSAGE: _coded([part.message for part in parts], counts, order),
        SIGNAL: _coded([part.signal for part in parts], counts, order),
        VALUE: np.concatenate([part.value for part in parts])[order],
        UNIT: _coded([part.unit for part in parts], counts, order),
    }


def _parts(found: MessageValues, codec: Codec) -> Iterator[_Part]:
    message = codec.tables[found.slot].message
    for name, decoded in found.signals.items():
        good = np.ones(len(found.rows), np.bool_) if decoded.is_good is None else decoded.is_good
        unit = message.get_signal_by_name(name).unit or ""
        yield _Part(message.name, name, unit, found.rows[good], decoded.value[good])


def _frame_columns(batch: FrameBatch, rows: Int64Array) -> dict[str, Any]:
    """Return time and channel of rows of a batch."""
    arrow = load_pyarrow()
    time = arrow.array(batch.t_ns[rows], type=arrow.timestamp("ns", "UTC"))
    return {TIME: time, CHANNEL: batch.channel[rows].astype(np.int64)}


def _coded(names: Sequence[str], counts: Sequence[int], order: Int64Array) -> Any:  # noqa: ANN401 - an untyped library
    """Return a text column as codes and their names: each name as often as it counts, then put in order."""
    arrow = load_pyarrow()
    known = {name: code for code, name in enumerate(dict.fromkeys(names))}
    codes = np.repeat(np.array([known[name] for name in names], np.int32), counts)[order]
    return arrow.DictionaryArray.from_arrays(arrow.array(codes), arrow.array(list(known), arrow.string()))


def _nullable(values: FloatArray) -> Any:  # noqa: ANN401 - an untyped library
    """Return numbers with null in the place of NaN."""
    return load_pyarrow().array(values, from_pandas=True)


def _signals_in(log: Path, codec: Codec, stop: Trigger) -> dict[str, str]:
    """Return ``Message.Signal`` and unit of all signals of the messages that a log holds, in the database's order."""
    seen: set[int] = set()
    for batch in read_log(log):
        if stop.is_set:
            break
        seen.update(slot for slot, _ in codec.rows(batch))
    units: dict[str, str] = {}
    for slot in sorted(seen):
        message = codec.tables[slot].message
        for name in codec.tables[slot].signals:
            units[f"{message.name}.{name}"] = message.get_signal_by_name(name).unit or ""
    return units


def _pieces(log: Path, size: int, stop: Trigger) -> Iterator[FrameBatch]:
    """Yield the frames of a log in batches of at most ``size``, until told to stop."""
    for batch in read_log(log):
        for start in range(0, len(batch), size):
            if stop.is_set:
                return
            yield batch[start : start + size]
