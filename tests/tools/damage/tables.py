"""Tables of signals of the short drive, as ten kinds of tools write them, and what is done to their rows."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from canlog.arrays import FloatArray
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.survey import proposed_profile
from ecu_emulator.log_formats.table import TableOptions, write_table
from tests.support import measurements
from tests.tools.damage.expected import Expected
from tests.tools.damage.kinds import (
    Damage,
    Generator,
    Recording,
    cut,
    flip_bits,
    insert_garbage,
    remove_piece,
    repeat_piece,
    swap_pieces,
)
from tests.tools.damage.recordings import short_drive, write_recorded

RATE_HZ: Final = 50.0
SLOW: Final = 5  # rows of a fast group for one of a slow one
DAY_S: Final = 1_790_000_000.0 // 86_400 * 86_400  # the date of a table whose times are those of a day


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """A table: when its rows were written [s], and what stands in them; NaN is a blank cell."""

    times_s: FloatArray
    heads: tuple[tuple[str, str], ...]  # name and unit
    cells: FloatArray

    def taken(self, rows: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> "Rows":
        """Return some rows in the order that is asked for."""
        return replace(self, times_s=self.times_s[rows], cells=self.cells[rows])


@cache
def short_table() -> Rows:
    """Return the short drive as a scan tool records it."""
    with tempfile.TemporaryDirectory() as folder:
        log, path = Path(folder) / "drive.log", Path(folder) / "drive.csv"
        write_recorded(log, short_drive())
        write_table(log, TableOptions(path=path, rate_hz=RATE_HZ, jitter_s=0.002, skew_ratio=0.5), 1)
        head, *lines = path.read_text(encoding="utf-8").splitlines()
    numbers = np.array([line.split(",") for line in lines], np.float64)
    named = [text.removesuffix("]").partition(" [")[::2] for text in head.split(",")[1:]]
    return Rows(times_s=numbers[:, 0] / 1e3, heads=tuple((name, unit) for name, unit in named), cells=numbers[:, 1:])


def text(rows: Rows, time: str, separator: str, stamped: Callable[[float], str], *, has_units_row: bool = False) -> str:
    """Return a table of texts."""
    heads = [name if has_units_row or not unit else f"{name} [{unit}]" for name, unit in rows.heads]
    lines = [separator.join([time.partition(" [")[0] if has_units_row else time, *heads])]
    if has_units_row:
        lines.append(separator.join(["s", *(unit or "-" for _, unit in rows.heads)]))
    for time_s, cells in zip(rows.times_s.tolist(), rows.cells.tolist(), strict=True):
        lines.append(separator.join([stamped(time_s), *("" if np.isnan(one) else f"{one:.10g}" for one in cells)]))
    return "\n".join([*lines, ""])


def moment(form: str) -> Callable[[float], str]:
    """Return what writes a moment by a form, to the millisecond."""

    def stamped(time_s: float) -> str:
        return (datetime.fromtimestamp(0, UTC) + timedelta(milliseconds=round(1e3 * time_s))).strftime(form)[:-3]

    return stamped


def arrow_table(rows: Rows) -> pa.Table:
    """Return it as columns, with units as pandas keeps none: in the names."""
    columns = {"Time [s]": rows.times_s}
    return pa.table(columns | {f"{name} [{unit}]": rows.cells[:, k] for k, (name, unit) in enumerate(rows.heads)})


def write_arrow(path: Path, rows: Rows) -> None:
    """Write a file of Arrow."""
    table = arrow_table(rows)
    with pa.ipc.new_file(path, table.schema) as writer:
        writer.write_table(table)


def write_measured(path: Path, rows: Rows) -> None:
    """Write groups of different rates, as INCA does: temperature and gears come seldom."""
    times_s = rows.times_s - measurements.START.timestamp()
    groups = dict[int, list[measurements.Measured]]()
    for place, (name, unit) in enumerate(rows.heads):
        every = SLOW if name == "Oil Temperature" else 1
        values = rows.cells[::every, place]
        invalid = np.isnan(values)
        one = measurements.Measured(
            name, unit, np.where(invalid, 0.0, values), invalid=invalid if any(invalid) else None
        )
        groups.setdefault(every, []).append(one)
    measurements.written(path, [(times_s[::every], channels) for every, channels in groups.items()])


def comma_decimals(path: Path, rows: Rows) -> None:
    """Write a German table."""
    path.write_text(text(rows, "Zeit [s]", ";", lambda time_s: f"{time_s:.3f}").replace(".", ","), encoding="utf-8")


GRAMMARS: Mapping[str, tuple[str, Callable[[Path, Rows], object]]] = MappingProxyType(
    {
        "table": (".csv", lambda path, rows: path.write_text(text(rows, "Time [ms]", ",", lambda t: f"{1e3 * t:.0f}"))),
        "table-units": (
            ".csv", lambda path, rows: path.write_text(text(rows, "t", ",", lambda t: f"{t:.3f}", has_units_row=True))
        ),
        "table-german": (".csv", comma_decimals),
        "table-tabs": (".tsv", lambda path, rows: path.write_text(text(rows, "Time [s]", "\t", lambda t: f"{t:.3f}"))),
        "table-clock": (
            ".csv", lambda path, rows: path.write_text(text(rows, "Time", ",", moment("%H:%M:%S.%f")))
        ),
        "table-iso": (
            ".csv", lambda path, rows: path.write_text(text(rows, "DateTime", ",", moment("%Y-%m-%dT%H:%M:%S.%f")))
        ),
        "table-windows": (
            ".csv",
            lambda path, rows: path.write_bytes(
                b"\xef\xbb\xbf" + text(rows, "Time [s]", ";", lambda t: f"{t:.3f}").replace("\n", "\r\n").encode()
            ),
        ),
        "table-parquet": (".parquet", lambda path, rows: pq.write_table(arrow_table(rows), path)),
        "table-arrow": (".arrow", write_arrow),
        "table-measured": (".mf4", write_measured),
    }
)  # fmt: skip
BINARY: Final = frozenset({"table-parquet", "table-arrow", "table-measured"})


def put(recording: Recording, rows: Rows, expected: Expected) -> Expected:
    """Write a damaged table; return what must be true of it."""
    GRAMMARS[recording.log_format][1](recording.target, rows)
    return expected


def garble_cells(recording: Recording, rng: Generator) -> Expected:
    """Make nonsense of some cells of a text, none of them the first of its row; in a binary table they are blank."""
    rows, count = short_table(), int(rng.integers(1, 40))
    places = rng.choice(rows.cells.size, count, replace=False)
    if recording.log_format in BINARY:
        cells = rows.cells.copy()
        cells.ravel()[places] = np.nan
        return put(recording, replace(rows, cells=cells), Expected())
    put(recording, rows, Expected())
    lines = recording.target.read_bytes().split(b"\n")
    first, width = len(lines) - 1 - len(rows.times_s), rows.cells.shape[1]
    separator = next(one for one in (b"\t", b";", b",") if one in lines[first])
    for row, column in zip(*np.divmod(places, width), strict=True):
        cells_of_row = lines[first + row].split(separator)
        cells_of_row[1 + column] = b"?" + rng.choice(np.arange(0x61, 0x7B), 6).astype(np.uint8).tobytes()
        lines[first + row] = separator.join(cells_of_row)
    recording.put(b"\n".join(lines))
    return Expected(rejected=count, must_be_noticed=True)


def blank_cells(recording: Recording, rng: Generator) -> Expected:
    """Leave a tenth of all cells blank."""
    rows = short_table()
    return put(recording, replace(rows, cells=np.where(rng.random(rows.cells.shape) < 0.1, np.nan, rows.cells)), SOUND)


def swap_rows(recording: Recording, rng: Generator) -> Expected:
    """Swap two rows, times and all."""
    order = np.arange(len(short_table().times_s))
    first, second = rng.choice(len(order), 2, replace=False)
    order[[first, second]] = order[[second, first]]
    return put(recording, short_table().taken(order), SOUND)


def repeat_rows(recording: Recording, rng: Generator) -> Expected:
    """Write some rows twice."""
    count = len(short_table().times_s)
    twice = rng.choice(count, int(rng.integers(1, 50)), replace=False)
    return put(recording, short_table().taken(np.sort(np.concatenate((np.arange(count), twice)))), SOUND)


def lose_rows(recording: Recording, rng: Generator) -> Expected:
    """Leave out some rows, alone and in a row."""
    is_kept = np.ones(len(short_table().times_s), np.bool_)
    is_kept[rng.choice(len(is_kept), int(rng.integers(1, 30)), replace=False)] = False
    first = int(rng.integers(len(is_kept)))
    is_kept[first : first + int(rng.integers(0, 60))] = False
    return put(recording, short_table().taken(np.flatnonzero(is_kept)), SOUND)


def hold_column(recording: Recording, rng: Generator) -> Expected:
    """Let one column keep its value from some row on, as a controller does that no longer answers."""
    rows = short_table()
    cells, row, column = rows.cells.copy(), int(rng.integers(len(rows.cells))), int(rng.integers(rows.cells.shape[1]))
    cells[row:, column] = cells[row, column]
    return put(recording, replace(rows, cells=cells), Expected())


def jump_ahead(recording: Recording, rng: Generator) -> Expected:
    """From some row on, be later by .3 s to an hour."""
    return jump(recording, rng, round(float(np.exp(rng.uniform(np.log(0.3), np.log(3600.0)))), 3))


def jump_back(recording: Recording, rng: Generator) -> Expected:
    """From some row on, be earlier by up to five seconds."""
    return jump(recording, rng, -round(float(rng.uniform(0.2, 5.0)), 3))


def jump(recording: Recording, rng: Generator, by_s: float) -> Expected:
    """Move everything from some row on."""
    rows = short_table()
    row, times_s = int(rng.integers(len(rows.times_s) // 20, len(rows.times_s))), rows.times_s.copy()
    times_s[row:] += by_s
    return put(recording, replace(rows, times_s=times_s), SOUND)


SOUND: Final = Expected(rejected=0)
TABLE_DAMAGES: Mapping[str, Damage] = MappingProxyType(
    {
        one.__name__: one
        for one in (
            flip_bits, cut, insert_garbage, remove_piece, repeat_piece, swap_pieces, garble_cells, blank_cells,
            swap_rows, repeat_rows, lose_rows, hold_column, jump_ahead, jump_back,
        )
    }
)  # fmt: skip


def decoder_of(table: Path) -> Callable[[], Decoder]:
    """Return what makes decoders by the profile that is proposed for a sound table."""
    profile = table.with_suffix(".toml")
    profile.write_text(proposed_profile(table), encoding="utf-8")
    return interpret(None, profile).decoder
