"""The columns of a drive, kept whole for what is worked out at its end."""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import replace

from canlog.arrays import Series
from canlog.frames import BEFORE_ALL_NS
from clutch_model.units import NS_PER_S
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.shifts.tracking import SampleHistory


class WholeDrive:
    """Keeps some signals of a drive, from its first sample on: eight of some thirty rows a second are 7 MB an hour."""

    def __init__(self, wanted: AbstractSet[Signal]) -> None:
        self._wanted = wanted
        self._history, self._moved_ns = SampleHistory(), 0

    def add(self, batch: ColumnBatch) -> None:
        """Keep the next columns; behind a jump of bus time they go on after a gap."""
        series = {signal: batch.columns[signal] for signal in self._wanted if signal in batch.columns}
        if series and batch.breaks_before:
            self._moved_ns = self._history.watermark_ns - min(int(one.t_ns[0]) for one in series.values()) + NS_PER_S
        moved = {signal: replace(one, t_ns=one.t_ns + self._moved_ns) for signal, one in series.items()}
        self._history.append(ColumnBatch(columns=moved, watermark_ns=batch.watermark_ns + self._moved_ns))

    @property
    def columns(self) -> Mapping[Signal, Series]:
        """All that was kept, by signal."""
        return self._history.cut(BEFORE_ALL_NS, self._history.watermark_ns + 1)
