"""``decode`` held against cantools, cell by cell of the Parquet files that it writes."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from studies.decoding.random_log import CLASSIC_BYTES, FD_BYTES, SentFrame, random_frames, write_candump
from canlog.column_files import TableFormat
from canlog.database.loading import load_database
from canlog.decode.codec import Codec, MessageTable
from canlog.tables.account import DecodeAccount
from canlog.tables.decoding import Plan, TableShape, decode_logs
from canlog.tables.layouts import Values, table_names
from tests.support.cantools_oracle import Readings, readings

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Int64Array = npt.NDArray[np.int64]
MESSAGES_AT_A_TIME: Final = 25
EXPLAINED: Final = ("refused", "transported")


@dataclass(slots=True, kw_only=True)
class Tally:
    """What was found; ``null`` counts values that cantools gives and the table does not, by reason."""

    messages: int = 0
    signals: int = 0
    values: int = 0  # numbers that both give
    texts: int = 0
    different: int = 0
    different_texts: int = 0
    extra: int = 0  # values where cantools gives none
    miscounted: int = 0  # messages whose account does not add up
    null: Counter[str] = field(default_factory=Counter)
    refusals: list[str] = field(default_factory=list)
    examples: list[str] = field(default_factory=list)  # of what is wrong

    @property
    def wrong(self) -> int:
        """Everything that must not be."""
        unexplained = sum(count for reason, count in self.null.items() if reason not in EXPLAINED)
        return self.different + self.different_texts + self.extra + self.miscounted + unexplained

    def add(self, other: "Tally") -> None:
        """Add what was found elsewhere."""
        for name in ("messages", "signals", "values", "texts", "different", "different_texts", "extra", "miscounted"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.null.update(other.null)
        self.refusals += other.refusals
        self.examples += other.examples


@dataclass(frozen=True, slots=True)
class _Cells:
    """One signal as a table has it, in the frames of its message."""

    number: FloatArray
    is_there: BoolArray
    text: list[str | None]


def compare_database(path: Path, count: int, seed: int) -> Tally:
    """Compare everything in one database on some payloads per message.

    Raises
    ------
    ConfigError
        If the database cannot be loaded.
    """
    codec = Codec(load_database(path).messages)
    rng = np.random.default_rng(seed)
    tally = Tally(refusals=[f"{old.name} has the identifier of {new.name}" for old, new in codec.overwritten])
    slots = [slot for slot, table in enumerate(codec.tables) if table.definitions]
    with TemporaryDirectory() as name:
        for start in range(0, len(slots), MESSAGES_AT_A_TIME):
            part = slots[start : start + MESSAGES_AT_A_TIME]
            tally.add(
                _compare(codec, part, random_frames([codec.tables[one].message for one in part], count, rng), name)
            )
    return tally


def _compare(codec: Codec, slots: Sequence[int], frames: Sequence[SentFrame], folder: str) -> Tally:
    """Compare some messages of a database."""
    log, wide = (Path(folder) / name for name in ("random.log", "wide.parquet"))
    write_candump(log, [codec.tables[slot].message for slot in slots], frames)
    names = table_names(codec.tables)
    wide_plan = Plan(codec=codec, names=names, shape=TableShape.WIDE, values=Values.BOTH)
    account = decode_logs([log], wide_plan, wide, TableFormat.PARQUET).account
    wide_table = _WideFile(wide, len(frames))
    tally = Tally()
    for place, slot in enumerate(slots):
        table = codec.tables[slot]
        rows = np.array([row for row, frame in enumerate(frames) if frame.place == place], np.int64)
        sent = [frames[row] for row in rows.tolist()]
        wanted = readings(table.message, table.definitions, [frame.payload for frame in sent])
        is_transported = np.array([_needs_transport(table, frame) for frame in sent], np.bool_)
        value_count = 0
        for name, expected in wanted.items():
            column = names.columns.get((slot, name), "")
            cells = wide_table.cells(column, rows)
            value_count += int(np.count_nonzero(cells.is_there))
            where = f"{names.messages[slot]}.{name}"
            _judge(tally, where, expected, cells, is_transported, is_refused=name in table.refused)
        _check_account(tally, account, slot, value_count, int(np.count_nonzero(is_transported)))
        tally.messages += 1
        tally.signals += len(wanted)
        tally.refusals += table.refused.values()
    if not account.is_balanced or account.log.frames != len(frames):
        tally.miscounted += 1
        tally.examples.append(f"{len(frames)} frames were sent, {account.log.frames} read, {account.fates}")
    return tally


def _needs_transport(table: MessageTable, frame: SentFrame) -> bool:
    """Return whether a frame can be a piece of its message only."""
    length = table.message.length
    return length > FD_BYTES or (length > CLASSIC_BYTES and not table.message.is_fd and not frame.is_fd)


def _judge(
    tally: Tally, where: str, expected: Readings, cells: _Cells, is_transported: BoolArray, *, is_refused: bool
) -> None:
    """Count how one column of a wide table compares with cantools."""
    both = expected.is_there & cells.is_there
    tally.values += int(np.count_nonzero(both))
    differs = both & _differ(expected.number, cells.number)
    extra, missing = cells.is_there & ~expected.is_there, expected.is_there & ~cells.is_there
    tally.different += int(np.count_nonzero(differs))
    tally.extra += int(np.count_nonzero(extra))
    explained = is_transported | is_refused
    tally.null["transported"] += int(np.count_nonzero(missing & is_transported))
    tally.null["refused"] += int(np.count_nonzero(missing & ~is_transported)) if is_refused else 0
    tally.null["without a reason"] += int(np.count_nonzero(missing & ~explained))
    wrong_texts = [
        row for row in np.flatnonzero(both).tolist() if expected.text[row] != cells.text[row]
    ]  # the same list for all: texts are few
    tally.texts += sum(text is not None for text in expected.text)
    tally.different_texts += len(wrong_texts)
    for row in [*np.flatnonzero(differs | extra | (missing & ~explained)).tolist()[:1], *wrong_texts[:1]]:
        tally.examples.append(
            f"{where}: {cells.number[row] if cells.is_there[row] else None} {cells.text[row]!r}, cantools "
            f"{expected.number[row] if expected.is_there[row] else None} {expected.text[row]!r}"
        )


def _check_account(tally: Tally, account: DecodeAccount, slot: int, value_count: int, transported_count: int) -> None:
    """Hold the account of one message against what was found in the table."""
    counted = sum(one.values for (owner, _), one in account.signals.items() if owner == slot)
    transported = account.transported.get(account.names.messages[slot], (0, 0))[1]
    if (counted, transported) != (value_count, transported_count):
        tally.miscounted += 1
        tally.examples.append(f"{account.names.messages[slot]}: {counted} values counted, {value_count} in the table")


def _differ(one: FloatArray, other: FloatArray) -> BoolArray:
    """Return where two columns differ in any bit; any NaN is as good as another."""
    both_nan = np.isnan(one) & np.isnan(other)
    differs: BoolArray = (one.view(np.uint64) != other.view(np.uint64)) & ~both_nan
    return differs


class _WideFile:
    """A wide Parquet file, read column by column."""

    def __init__(self, path: Path, frame_count: int) -> None:
        self._file = pq.ParquetFile(path)
        self._names = set(self._file.schema_arrow.names)
        time = self._file.read(columns=["time"]).column("time")
        self._row_of = np.full(frame_count, -1, np.int64)
        self._row_of[_frame_numbers(time)] = np.arange(len(time))

    def cells(self, column: str, frames: Int64Array) -> _Cells:
        """Return a column and its texts in some frames."""
        if column not in self._names:
            return _Cells(np.zeros(len(frames)), np.zeros(len(frames), np.bool_), [None] * len(frames))
        wanted = [name for name in (column, f"{column}.text") if name in self._names]
        table = self._file.read(columns=wanted)
        row = self._row_of[frames]
        number, is_valid = _numbers(table.column(column))
        texts = table.column(wanted[1]).to_pylist() if len(wanted) > 1 else [None] * table.num_rows
        return _Cells(
            number[row], is_valid[row] & (row >= 0), [texts[one] if one >= 0 else None for one in row.tolist()]
        )


def _frame_numbers(time: Any) -> Int64Array:  # noqa: ANN401 - of pyarrow
    """Return the number of the frame of each row, as ``write_candump`` times them."""
    nanoseconds: Int64Array = time.cast(pa.int64()).to_numpy()
    return (nanoseconds - 1_000_000_000) // 1000


def _numbers(column: Any) -> tuple[FloatArray, BoolArray]:  # noqa: ANN401 - of pyarrow
    """Return the numbers of a column, and which of them are not null."""
    is_valid = column.is_valid().to_numpy(zero_copy_only=False)
    return column.fill_null(0.0).to_numpy(), is_valid


def explained(null: Mapping[str, int]) -> str:
    """Return how many values are null and why, in words."""
    return ", ".join(f"{count} {reason}" for reason, count in null.items() if count) or "none"
