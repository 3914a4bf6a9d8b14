"""MDF 4 files as measuring tools write them: groups of different rates, conversions, units, invalid values."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from asammdf import MDF, Signal

from canlog.arrays import BoolArray, FloatArray

START = datetime(2026, 1, 31, 12, 0, 0, tzinfo=UTC)


class Measured(NamedTuple):
    """A channel: ``step`` makes it a whole number of steps from ``offset`` in the file, as controllers keep numbers."""

    name: str
    unit: str
    values: FloatArray
    step: float = 0.0
    offset: float = 0.0
    invalid: BoolArray | None = None
    dtype: str = "<i4"


def written(
    path: Path,
    groups: Sequence[tuple[FloatArray, Sequence[Measured]]],
    *,
    version: str = "4.10",
    compression: Literal[0, 2] = 2,
) -> None:
    """Write groups of channels, each with its times [s] from the start."""
    with MDF(version=version) as file:
        file.header.start_time = START
        for times_s, channels in groups:
            file.append([_signal(times_s, one) for one in channels])
        file.save(path, compression=compression, overwrite=True)


def of_table(table: Path, path: Path, slow: Sequence[str] = (), names: str = "{}\\ETKC:1") -> None:
    """Write a table of a scan tool as measurement: all its columns in a group, every fifth row of the slow ones."""
    head, *lines = table.read_text(encoding="utf-8").splitlines()
    cells = np.array([line.split(",") for line in lines], np.float64)
    named = [text.removesuffix("]").partition(" [")[::2] for text in head.split(",")]
    times_s = cells[:, 0] / 1e3 - START.timestamp()
    fast, rare = list[Measured](), list[Measured]()
    for place, (name, unit) in enumerate(named[1:], 1):
        is_slow = name in slow
        one = Measured(names.format(name), unit, cells[:: 5 if is_slow else 1, place])
        (rare if is_slow else fast).append(one)
    written(path, [(times_s, fast), *([(times_s[::5], rare)] if rare else [])])


def _signal(times_s: FloatArray, one: Measured) -> Signal:
    values, conversion = one.values, dict[str, object]()
    if one.step:
        values = np.rint((values - one.offset) / one.step).astype(one.dtype)
        conversion = {"a": one.step, "b": one.offset}
    return Signal(
        values, times_s, unit=one.unit, name=one.name, conversion=conversion or None, invalidation_bits=one.invalid
    )
