"""Parquet files of our own, read by pyarrow and by polars: every value, every null, limits that may be relied on."""

import io
from typing import Any, Final

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from canlog.parquet import contents
from canlog.parquet.codes import Packer
from canlog.parquet.column_file import ColumnFile
from canlog.parquet.packing import GROUP, LEAST_RUN, MOST_GROUPS

KINDS: Final = {
    "time": "timestamp[ns, UTC]",
    "channel": "int64",
    "id": "int32",
    "is_extended": "bool",
    "message": "name",
    "never": "float64",
    **{f"value{number}": "float64" for number in range(6)},
}
SHARES: Final = (1.0, 0.9, 0.5, 0.1, 0.01, 0.0)  # of the rows that have a value
HIGHEST: Final = (2**52, 3, 70_000, 4_096, 5, 9)  # of raw values
LONGEST: Final = (1, 3, 9, 50, 3, 2)  # runs of one value
NAMES: Final = ("Brake", "Grüße", "a, b")
Columns = dict[str, list[Any]]


def write_group(file: ColumnFile, rng: np.random.Generator, count: int) -> Columns:
    """Write random rows; return what must be read."""
    packer, everywhere = file.packer, file.levels(np.arange(count), count)
    t_ns = 10**18 + np.cumsum(rng.integers(-3, 1_000_000, count)) - rng.integers(0, 2, count) * 10**15
    channel, can_id = rng.integers(0, 3, count), rng.integers(0, 2**29, count)
    is_extended, name = rng.random(count) < 0.5, np.sort(rng.integers(0, 3, count))
    file.add("time", KINDS["time"], everywhere, contents.times(t_ns, packer))
    for column, values, kind in (("channel", channel, np.int64), ("id", can_id, np.int32)):
        found = packer.numbered(values)
        body = packer.runs(found.index, len(found.distinct))
        file.add(column, KINDS[column], everywhere, contents.whole_numbers(found.distinct.astype(kind), body))
    file.add("is_extended", "bool", everywhere, contents.flags(is_extended))
    file.add("message", "name", everywhere, contents.names(NAMES, packer.runs(name.astype(np.int32), len(NAMES))))
    written: Columns = {
        "time": t_ns.tolist(),
        "channel": channel.tolist(),
        "id": can_id.tolist(),
        "is_extended": is_extended.tolist(),
        "message": [NAMES[one] for one in name.tolist()],
        "never": [None] * count,
    }
    for number, (share, highest, longest) in enumerate(zip(SHARES, HIGHEST, LONGEST, strict=True)):
        rows = np.flatnonzero(rng.random(count) < share)
        raw = np.repeat(rng.integers(0, highest, len(rows)), rng.integers(1, longest + 1, len(rows)))[: len(rows)]
        found = packer.numbered(raw)
        if len(rows):
            content = contents.numbers(np.multiply(found.distinct, 0.1) - 4, found.index, packer)
            file.add(f"value{number}", "float64", file.levels(rows, count), content)
        cells = [None] * count
        for row, value in zip(rows.tolist(), (raw * 0.1 - 4).tolist(), strict=True):
            cells[row] = value
        written[f"value{number}"] = cells
    file.end_group(count)
    return written


@pytest.mark.parametrize("counts", [(1, 2, 9), (700, 1, 3_000), (20_000,)], ids=str)
def test_everything_is_read_as_it_was_written(counts: tuple[int, ...]) -> None:
    rng, output = np.random.default_rng(sum(counts)), io.BytesIO()
    file = ColumnFile(output)
    groups = [write_group(file, rng, count) for count in counts]
    file.close(KINDS, {"value1": {"unit": "rpm"}})
    written = {name: [cell for group in groups for cell in group[name]] for name in KINDS}
    table = pq.read_table(io.BytesIO(output.getvalue()))
    assert table.schema.names == list(KINDS)
    assert table.schema.field("value1").metadata[b"unit"] == b"rpm"
    assert pq.ParquetFile(io.BytesIO(output.getvalue())).metadata.num_row_groups == len(counts)
    of_polars = pl.read_parquet(io.BytesIO(output.getvalue()))
    for name, cells in written.items():
        column = table[name].cast(pa.int64()) if name == "time" else table[name]
        assert column.to_pylist() == cells, name
        assert (of_polars[name].to_physical() if name == "time" else of_polars[name]).to_list() == cells, name


def test_limits_say_where_values_lie() -> None:
    output = io.BytesIO()
    file = ColumnFile(output)
    columns = {
        "plain": (2.5, -7.0, 3.0),
        "zeros": (0.0, 1.0, 0.0),
        "odd": (1.0, float("nan"), 2.0),
    }
    levels = file.levels(np.array([0, 2, 3]), 5)
    for name, values in columns.items():
        found = file.packer.numbered(np.array(values).view(np.int64))
        file.add(name, "float64", levels, contents.numbers(found.distinct.view(np.float64), found.index, file.packer))
    file.end_group(5)
    file.close(dict.fromkeys(columns, "float64"), {})
    group = pq.ParquetFile(output).metadata.row_group(0)
    plain, zeros, odd = (group.column(place).statistics for place in range(3))
    assert (plain.min, plain.max, plain.null_count) == (-7.0, 3.0, 2)
    assert (np.signbit(zeros.min), zeros.max) == (True, 1.0)
    assert not odd.has_min_max


def hybrid_values(packed: bytes, count: int) -> list[int]:
    """Return the numbers in a page of runs and packed bits, read as the specification says."""
    width, at, values = packed[0], 1, list[int]()
    while len(values) < count:
        header = shift = 0
        while True:
            byte, at = packed[at], at + 1
            header, shift = header | (byte & 0x7F) << shift, shift + 7
            if byte < 0x80:
                break
        if header & 1:
            size = (header >> 1) * width
            bits = int.from_bytes(packed[at : at + size], "little")
            values += [bits >> width * place & 2**width - 1 for place in range(8 * (header >> 1))]
        else:
            size = (width + 7) // 8
            values += [int.from_bytes(packed[at : at + size], "little")] * (header >> 1)
        at += size
    assert at == len(packed)
    return values[:count]


@pytest.mark.parametrize("most", [1, 2, 3, 255, 256, 70_000])
def test_runs_and_packed_bits_follow_the_specification(most: int) -> None:
    packer, rng = Packer(), np.random.default_rng(most)
    for count in (1, GROUP - 1, GROUP, LEAST_RUN, LEAST_RUN + 3, GROUP * MOST_GROUPS + 1, 3_000):
        for longest in (1, 3, 40):
            values = np.repeat(rng.integers(0, most, count), rng.integers(1, longest + 1, count))[:count]
            index = values.astype(np.int32)
            assert hybrid_values(packer.runs(index, most), count) == values.tolist()
