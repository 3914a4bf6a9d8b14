"""The truth of a live drive: kept back until the frames that belong to it have been sent."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from queue import SimpleQueue
from typing import Final, Protocol

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.bus.sender import TransmitReport
from ecu_emulator.drive.recording import SHORT_STRETCH_S, Drive
from ecu_emulator.truth import DriveTruth, EventTruth, Happened, ShiftTruth, Totals, known_at_s


class TruthSink(Protocol):
    """Who hears the truth about a drive, as it becomes known."""

    def drive(self, drive: DriveTruth) -> None:
        """Hear what is true for the whole drive, first of all."""

    def write(self, truths: Iterable[Happened]) -> None:
        """Hear what has happened."""

    def totals(self, totals: Totals) -> None:
        """Hear what the drive amounted to, last of all."""


class SentTruth:
    """Hands a drive's frames to the bus and keeps back the truth of what happened until its frames have been sent."""

    def __init__(self, drive: Drive, writer: TruthSink | None) -> None:
        self.drive: Final = drive
        self._writer = writer
        self._ahead: SimpleQueue[Happened] = SimpleQueue()  # filled by the thread that drives
        self._next: Happened | None = None
        self.shift_count = 0
        self.event_count = 0
        self.sent_s = 0.0
        if writer is not None:
            writer.drive(drive.truth)

    def frames(self) -> Iterator[EncodedFrames]:
        """Drive, and yield what is to be sent; may run in a thread of its own."""
        for stretch in self.drive.stretches(SHORT_STRETCH_S):
            for truth in stretch.truths:
                self._ahead.put(truth)
            yield stretch.frames

    def sent_until(self, t_s: float) -> None:
        """Write what had happened by this scenario time [s]."""
        self.sent_s = t_s
        while True:
            if self._next is None and not self._ahead.empty():
                self._next = self._ahead.get()
            if self._next is None or known_at_s(self._next) > t_s:
                return
            self._write(self._next)
            self._next = None

    def _write(self, truth: Happened) -> None:
        if self._writer is not None:
            self._writer.write([truth])
        self.shift_count += isinstance(truth, ShiftTruth)
        self.event_count += isinstance(truth, EventTruth)

    def finish(self, report: TransmitReport) -> None:
        """Write what is left, and the totals of what was sent."""
        if report.is_complete:
            self.sent_until(self.drive.totals.duration_s)
        if self._writer is not None:
            self._writer.totals(
                replace(
                    self.drive.totals,
                    shifts=self.shift_count,
                    events=self.event_count,
                    duration_s=self.sent_s,
                    frames=report.frames_sent,
                )
            )
