"""Parquet and Arrow tables of signals, read by pyarrow as `canlog.logs.signal_tables` reads texts.

The unit of a column is its field's metadata ``unit``, as ``diag-service decode`` writes it, or stands in its name.
"""

import io
import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.column_files import load_pyarrow
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.logs.log_counts import LogCounts
from canlog.logs.signal_tables import checked_rows, is_rising, signal_columns, time_places, time_unit_us

PARQUET_MAGIC, ARROW_MAGIC, ARROW_STREAM_MAGIC = b"PAR1", b"ARROW1", b"\xff\xff\xff\xff"
ROWS, CELLS = 16_384, 4_000_000  # of a batch, at most
FREE_ROWS, ROWS_PER_BYTE = 1_000_000, 1_000  # a file that claims more was made to do harm
FREE_BYTES, PACKED_RATIO = 128 << 20, 50  # of a batch as it is unpacked, and over its packed bytes
NS_PER_US: Final = 1000.0
UNIT: Final = b"unit"
RECORD_BATCH: Final = 3  # a kind of message
DAMAGE: Final = (OSError, ValueError, TypeError, LookupError, OverflowError, MemoryError)  # that pyarrow falls over


class _Plan(NamedTuple):
    """Which field of a table holds its times, and in what unit; which fields are signals."""

    time_place: int
    us_per_unit: float | None  # None: they are timestamps
    columns: tuple[SignalColumn, ...]
    places: tuple[int, ...]
    notes: tuple[str, ...]


def arrow_columns(stream: BinaryIO) -> tuple[SignalColumn, ...]:
    """Return the columns of a Parquet or Arrow table; the stream is then at its beginning again.

    Raises SourceError if it is damaged or holds no table of signals, ExtraMissingError without pyarrow.
    """
    with _translated():
        schema, batches = _opened(stream)
        plan = _planned(schema, next(batches, None))
    stream.seek(0)
    return plan.columns


def read_arrow_table(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the values of a Parquet or Arrow table as frames; raises as `arrow_columns`."""
    with _translated():
        schema, batches = _opened(stream)
        plan: _Plan | None = None
        for batch in batches:
            if plan is None:
                plan = _planned(schema, batch)
                for note in plan.notes:
                    counts.note(note)
                ids = np.array([column_id(one.name) | EXTENDED_FLAG for one in plan.columns], np.uint32)
            time_us = _times_us(batch.column(plan.time_place), plan.us_per_unit)
            values = np.column_stack([_numbers(batch.column(place)) for place in plan.places])
            frames = checked_rows(time_us, values, ids, counts)
            if len(frames):
                counts.frames += len(frames)
                yield frames


class _Borrowed(io.RawIOBase):
    """A stream that pyarrow reads, and closes when it likes: whoever opened it closes it."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__()
        self._stream = stream

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.seek(0, os.SEEK_CUR)

    def read(self, size: int = -1, /) -> bytes:
        return self._stream.read(size)


class _translated:  # noqa: N801 - used as a function
    """Turns what pyarrow says of a damaged file into a SourceError."""

    def __enter__(self) -> None:
        load_pyarrow()

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if isinstance(error, (load_pyarrow().ArrowException, *DAMAGE)) and not isinstance(error, SourceError):
            first = str(error).partition("\n")[0]
            raise SourceError(f"the table is damaged: {first}") from error


def _opened(stream: BinaryIO) -> tuple[Any, Iterator[Any]]:
    """Return the schema of a table, and its rows in batches."""
    arrow = load_pyarrow()
    beginning = stream.read(len(ARROW_MAGIC))
    stream.seek(0)
    file = arrow.PythonFile(_Borrowed(stream), mode="r")
    if beginning.startswith(PARQUET_MAGIC):
        table = arrow.parquet.ParquetFile(file)
        if table.metadata.num_rows > FREE_ROWS + ROWS_PER_BYTE * stream.seek(0, os.SEEK_END):
            raise SourceError(f"it claims {table.metadata.num_rows} rows, more than times can be packed into its bytes")
        return table.schema_arrow, table.iter_batches(min(ROWS, max(1, CELLS // len(table.schema_arrow))))
    _check_batches(stream)
    if beginning.startswith(ARROW_MAGIC):
        whole = arrow.ipc.open_file(file)
        return whole.schema, (whole.get_batch(number) for number in range(whole.num_record_batches))
    reader = arrow.ipc.open_stream(file)
    return reader.schema, iter(reader)


def _check_batches(stream: BinaryIO) -> None:
    """Raise SourceError if a batch of an Arrow stream would unpack to far more than its bytes; damage is told later.

    Each message is a length, what it holds as a flatbuffer, and its body (Arrow's columnar format, IPC messages).
    """
    position = 8 if stream.read(len(ARROW_MAGIC)) == ARROW_MAGIC else 0
    with suppress(struct.error, IndexError):
        while stream.seek(position) is not None and (head := stream.read(8))[:4] == ARROW_STREAM_MAGIC:
            (size,) = struct.unpack_from("<i", head, 4)
            if size <= 0:
                break
            cells, body = _claimed(stream.read(size))
            if cells * 8 > max(FREE_BYTES, PACKED_RATIO * body):
                raise SourceError(f"a batch of it claims {cells} values in {body} bytes")
            position += 8 + size + body
    stream.seek(0)


def _claimed(message: bytes) -> tuple[int, int]:
    """Return how many values a message says that it has, and the bytes of its body; raises struct.error."""
    top = struct.unpack_from("<I", message, 0)[0]
    body = _field(message, top, 3)
    length = struct.unpack_from("<q", message, body)[0] if body else 0
    kind, header = _field(message, top, 1), _field(message, top, 2)
    if length < 0 or not kind or message[kind] != RECORD_BATCH or not header:
        return 0, max(length, 0)
    batch = header + struct.unpack_from("<I", message, header)[0]
    rows, nodes = _field(message, batch, 0), _field(message, batch, 1)
    if not rows or not nodes:
        return 0, length
    count = struct.unpack_from("<I", message, nodes + struct.unpack_from("<I", message, nodes)[0])[0]
    return struct.unpack_from("<q", message, rows)[0] * count, length


def _field(message: bytes, table: int, number: int) -> int:
    """Return where a field of a table of a flatbuffer is; 0 if it is not there."""
    layout = table - struct.unpack_from("<i", message, table)[0]
    if 4 + 2 * number >= struct.unpack_from("<H", message, layout)[0]:
        return 0
    offset = struct.unpack_from("<H", message, layout + 4 + 2 * number)[0]
    return table + offset if offset else 0


def _planned(schema: Any, batch: Any) -> _Plan:  # noqa: ANN401 - of pyarrow
    """Return which fields are what, by their types, names and first values."""
    types = load_pyarrow().types
    units = [(field.metadata or {}).get(UNIT, b"").decode("utf-8", "replace") for field in schema]
    columns, notes = signal_columns([field.name for field in schema], units)
    is_number = [
        types.is_integer(one.type) or types.is_floating(one.type) or types.is_boolean(one.type) for one in schema
    ]
    is_number = [one or types.is_decimal(field.type) for one, field in zip(is_number, schema, strict=True)]
    for place in time_places([field.name for field in schema]) if batch is not None else ():
        is_moment = types.is_timestamp(schema[place].type)
        if not (is_moment or is_number[place]):
            continue
        times = _times_us(batch.column(place), None if is_moment else 1.0)
        if not is_rising(times[np.isfinite(times)].tolist()):
            continue
        unit: float | None = None
        if not is_moment:
            unit, said = time_unit_us(columns[place].unit, times[np.isfinite(times)], columns[place].name)
            notes += said
        places = tuple(one for one in range(len(columns)) if is_number[one] and one != place and columns[one].name)
        if places:
            return _Plan(place, unit, tuple(columns[one] for one in places), places, tuple(notes))
    raise SourceError("a table without a column of times that rise, or without numbers beside it")


def _times_us(column: Any, us_per_unit: float | None) -> FloatArray:  # noqa: ANN401 - of pyarrow
    """Return times [us], NaN where there is none."""
    if us_per_unit is not None:
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged number
            return np.rint(_numbers(column) * us_per_unit)
    arrow = load_pyarrow()
    nanoseconds = column.cast(arrow.timestamp("ns", column.type.tz), safe=False).cast(arrow.int64())
    return np.rint(_numbers(nanoseconds) / NS_PER_US)


def _numbers(column: Any) -> FloatArray:  # noqa: ANN401 - of pyarrow
    """Return numbers, NaN where there is none."""
    values: FloatArray = column.cast(load_pyarrow().float64(), safe=False).to_numpy(zero_copy_only=False)
    return values
