"""The truth of a drive in memory, for whoever drives from Python."""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final

from ecu_emulator.errors import ConfigError
from ecu_emulator.live.sent_truth import TruthSink
from ecu_emulator.truth.records import DriveTruth, Happened, Totals, TruthLog, truth_log

MOST_KEPT: Final = 100_000  # of an endless drive the last ones, half a kilobyte each


class TruthMemory:
    """Keeps what is true of a drive; one thread may write while others read."""

    def __init__(self) -> None:
        self._drive: DriveTruth | None = None
        self._happened: deque[Happened] = deque(maxlen=MOST_KEPT)
        self._totals: Totals | None = None

    def drive(self, drive: DriveTruth) -> None:
        """Keep what is true for the whole drive."""
        self._drive = drive

    def write(self, truths: Iterable[Happened]) -> None:
        """Keep what has happened."""
        self._happened.extend(truths)

    def totals(self, totals: Totals) -> None:
        """Keep what the drive amounted to."""
        self._totals = totals

    def log(self) -> TruthLog:
        """Return all of it; raises ConfigError before the drive has begun."""
        if self._drive is None:
            raise ConfigError("the car is not driving yet: there is no truth")
        return truth_log(self._drive, self._happened.copy(), self._totals)


class SharedTruth:
    """Tells several of the same."""

    def __init__(self, sinks: Sequence[TruthSink]) -> None:
        self._sinks = tuple(sinks)

    def drive(self, drive: DriveTruth) -> None:
        """Tell all what is true for the whole drive."""
        for sink in self._sinks:
            sink.drive(drive)

    def write(self, truths: Iterable[Happened]) -> None:
        """Tell all what has happened."""
        kept = tuple(truths)
        for sink in self._sinks:
            sink.write(kept)

    def totals(self, totals: Totals) -> None:
        """Tell all what the drive amounted to."""
        for sink in self._sinks:
            sink.totals(totals)
