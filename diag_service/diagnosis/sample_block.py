"""Samples of many signals in one piece: a compiled pass fills them in, and they are read like any other columns."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from diag_service.diagnosis.columns import Signal


class Samples(NamedTuple):
    """Samples of k signals, each row filled from its beginning."""

    filled: Int64Array  # (k,) where each row ends
    t_ns: Int64Array  # (k, n)
    sequence: Int64Array  # (k, n)
    value: FloatArray  # (k, n)


def empty_rows(count: int, size: int) -> Samples:
    """Return empty rows for ``size`` samples each."""
    return Samples(
        filled=np.zeros(count, np.int64),
        t_ns=np.empty((count, size), np.int64),
        sequence=np.empty((count, size), np.int64),
        value=np.empty((count, size)),
    )


class BlockLayout:
    """Which signal is in which row of a block, and how often it comes."""

    def __init__(self, signals: Sequence[Signal], period_ns: Sequence[int]) -> None:
        self.signals = tuple(signals)
        self.period_ns = tuple(period_ns)
        self.row = {signal: row for row, signal in enumerate(signals)}

    def room(self, size: int) -> Samples:
        """Return empty rows for ``size`` samples each."""
        return empty_rows(len(self.signals), size)


class SampleBlock(Mapping[Signal, Series]):
    """Columns that are made into series when somebody asks for them; signals without a sample are not among them."""

    __slots__ = ("layout", "samples")

    def __init__(self, layout: BlockLayout, samples: Samples) -> None:
        self.layout = layout
        self.samples = samples

    def __getitem__(self, signal: Signal) -> Series:
        row = self.layout.row[signal]
        count = self.samples.filled[row]
        if not count:
            raise KeyError(signal)
        return Series(
            t_ns=self.samples.t_ns[row, :count],
            sequence=self.samples.sequence[row, :count],
            value=self.samples.value[row, :count],
            period_ns=self.layout.period_ns[row],
        )

    def __iter__(self) -> Iterator[Signal]:
        return (
            signal for signal, count in zip(self.layout.signals, self.samples.filled.tolist(), strict=True) if count
        )

    def __len__(self) -> int:
        return int(np.count_nonzero(self.samples.filled))
