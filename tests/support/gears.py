"""Hand-made gear signals for the shift detector."""

from collections.abc import Mapping, Sequence

import numpy as np

from canlog.arrays import Series
from diag_service.diagnosis.columns import ColumnBatch, Signal

STEP_NS = 10_000_000


def batch_of(columns: Mapping[Signal, Series], *, breaks_before: bool = False) -> ColumnBatch:
    """Return a batch whose watermark is its latest sample."""
    latest_ns = max(int(series.t_ns[-1]) for series in columns.values())
    return ColumnBatch(columns=columns, watermark_ns=latest_ns, breaks_before=breaks_before)


def gear_batch(gears: Sequence[tuple[int, int]], *, first_row: int = 0, breaks_before: bool = False) -> ColumnBatch:
    """Return (current, target) gears sampled every 10 ms from row ``first_row`` on."""
    rows = first_row + np.arange(len(gears), dtype=np.int64)
    values = np.array(gears, dtype=np.float64)
    return batch_of(
        {
            signal: Series(t_ns=rows * STEP_NS, sequence=rows, value=values[:, column], period_ns=STEP_NS)
            for column, signal in enumerate((Signal.CURRENT_GEAR, Signal.TARGET_GEAR))
        },
        breaks_before=breaks_before,
    )
