"""What the columns of a table of signals hold: range, step of quantisation, and how often a value changes."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.frames import EXTENDED_FLAG, FrameBatch

MOST_DISTINCT = 4096  # values of a column that are kept to find its step


@dataclass(slots=True)
class ColumnValues:
    """The values of one column.

    ``step`` is the smallest difference between two of its values, 0 for a constant; of a column with very many values
    it is that of the first ones. A value that equals the one before it was perhaps not measured anew.
    """

    name: str
    unit: str
    count: int = 0
    changes: int = 0
    lowest: float = np.inf
    highest: float = -np.inf
    step: float = 0.0
    _distinct: FloatArray | None = None
    _last: float = np.nan

    def add(self, values: FloatArray) -> None:
        """Count more values, oldest first."""
        self.count += len(values)
        self.lowest, self.highest = min(self.lowest, float(values.min())), max(self.highest, float(values.max()))
        self.changes += int(np.count_nonzero(np.diff(values, prepend=self._last)))
        self.changes -= int(np.isnan(self._last))  # the first value is no change
        self._last = float(values[-1])
        known = values if self._distinct is None else np.concatenate([self._distinct, values])
        self._distinct = np.unique(known)[:MOST_DISTINCT]
        self.step = float(np.diff(self._distinct).min(initial=np.inf)) if len(self._distinct) > 1 else 0.0


class TableValues:
    """The values of all columns of a table."""

    def __init__(self, columns: Iterable[SignalColumn]) -> None:
        self._of_id = {column_id(one.name) | EXTENDED_FLAG: ColumnValues(one.name, one.unit) for one in columns}

    @property
    def names(self) -> dict[int, str]:
        """The names of the columns by their identifiers, with the flag of an extended one."""
        return {can_id: one.name for can_id, one in self._of_id.items()}

    def add(self, batch: FrameBatch) -> None:
        values = np.ascontiguousarray(batch.data[:, :8]).view("<f8").ravel()
        order = np.argsort(batch.can_id, kind="stable")
        found, starts = np.unique(batch.can_id[order], return_index=True)
        for can_id, rows in zip(found.tolist(), np.split(order, starts[1:]), strict=True):
            if can_id in self._of_id:
                self._of_id[can_id].add(values[rows])

    def of(self, can_id: int) -> ColumnValues:
        """Return what the column with an identifier holds."""
        return self._of_id[can_id]
