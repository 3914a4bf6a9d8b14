"""One drive, written in every dialect, is read with the same names, units, times and values."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.database.signal_columns import column_id
from canlog.frames import EXTENDED_FLAG
from canlog.logs.detection import LogFormat, detect
from canlog.logs.signal_tables import read_signal_table
from tests.support.batches import read_whole
from tests.support.table_dialects import CLOCKS, PROGRAMS, Dialect, Drive, drawn, drive_of, written

COUNT = 60
DRIVE = drive_of([980 + 2 * row for row in range(COUNT)], [row / 100.0 for row in range(COUNT)], 50)


def is_read(drive: Drive, text: bytes) -> None:
    detected = detect(text)
    assert detected.format is LogFormat.SIGNALS
    columns = {column for column in detected.columns if column.name != "No"}
    assert columns == set(drive.channels)
    batch, counts = read_whole(read_signal_table, text)
    assert not counts.rejected
    values = np.ascontiguousarray(batch.data).view("<f8").ravel()
    for column, (_, expected) in drive.channels.items():
        rows = batch.can_id == (column_id(column.name) | EXTENDED_FLAG)
        there = [(at, value) for at, value in zip(drive.times_ms, expected, strict=True) if value is not None]
        np.testing.assert_allclose(values[rows], [value for _, value in there], rtol=1e-12)
        times_ms = (batch.t_ns[rows] - batch.t_ns.min()) / 1e6
        np.testing.assert_allclose(times_ms, [at for at, _ in there], atol=1.01)


@settings(max_examples=120, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    speed_rpm=st.lists(st.integers(700, 7000), min_size=COUNT, max_size=COUNT),
    pressure_bar=st.lists(st.integers(0, 2000).map(lambda value: value / 100.0), min_size=COUNT, max_size=COUNT),
    step_ms=st.sampled_from([10, 50, 100, 430, 1000]),
)
def test_one_drive_in_every_dialect(seed: int, speed_rpm: list[int], pressure_bar: list[float], step_ms: int) -> None:
    drive = drive_of(speed_rpm, pressure_bar, step_ms)
    is_read(drive, written(drive, drawn(random.Random(seed))))  # noqa: S311 - a draw that repeats


@pytest.mark.parametrize("clock", CLOCKS)
def test_one_drive_by_every_clock(clock: str) -> None:
    dialect = Dialect(
        separator=";", decimal=",", grouping=".", clock=clock, header=("names", "units"), preamble=(), clock_place=0,
        has_row_numbers=True, has_units_in_cells=False, has_surplus_name=False, is_ragged=True, encoding="utf-8",
        newline="\n",
    )  # fmt: skip
    is_read(DRIVE, written(DRIVE, dialect))


@pytest.mark.parametrize("program", PROGRAMS)
def test_one_drive_in_the_layout_of_each_program(program: str) -> None:
    is_read(DRIVE, PROGRAMS[program](DRIVE))
