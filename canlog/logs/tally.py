"""What a log reader found besides frames: counted and located, never fatal."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

MOST_NOTES = 8


class LogReject(StrEnum):
    """Why a piece of a log gave no frame."""

    MALFORMED = "malformed"  # not in the grammar of the format
    CUT_OFF = "cut_off"  # the file ends inside it
    GIVEN_UP = "given_up"  # so much without a frame before it that what follows was not read
    DAMAGED = "damaged"  # a container or object whose size or compression is wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class LogCounts:
    """What a log held, as far as it has been read."""

    frames: int = 0
    skipped: int = 0  # comments, events and other things that are no frames and are not meant to be
    rejected: Mapping[LogReject, int] = field(default_factory=dict)
    first_rejected: str = ""  # where and why, for people
    truncated: bool = False  # the file ends before its own end
    jumps_back: int = 0  # frames whose time lies before that of the frame before
    jumps_ahead: int = 0  # frames after a silence that ends a segment
    first_jump: str = ""  # where and how far, for people
    repeated: int = 0  # frames that equal the one before, time and all
    unfinished: bool = False  # its writer did not close it: what is missing at the end cannot be told
    notes: tuple[str, ...] = ()  # what had to be assumed, for people: a unit, a date that is not understood

    @property
    def first_fault(self) -> str:
        """What is wrong with the log, so that nobody has to look further; empty if nothing is."""
        end = "the file ends before its own end" if self.truncated else ""
        return self.first_rejected or self.first_jump or end


class Tally:
    """The running counts of one reader."""

    def __init__(self) -> None:
        self.frames = 0
        self.skipped = 0
        self.truncated = False
        self.unfinished = False
        self.repeated = 0
        self._jumps_back = 0
        self._jumps_ahead = 0
        self._first_jump = ""
        self._rejected: Counter[LogReject] = Counter()
        self._first_rejected = ""
        self._notes: dict[str, None] = {}

    def note(self, text: str) -> None:
        """Say what had to be assumed about the log; each thing once, and no more than a few."""
        if len(self._notes) < MOST_NOTES:
            self._notes.setdefault(text)

    def reject(self, reason: LogReject, place: str, count: int = 1) -> None:
        """Count pieces that gave no frame; ``place`` is where the first of them is."""
        if count == 0:
            return
        if not self._rejected:
            self._first_rejected = f"{place}: {reason}"
        self._rejected[reason] += count

    @property
    def rejects(self) -> int:
        """How many pieces gave no frame."""
        return self._rejected.total()

    def jump(self, back: int, ahead: int, place: str) -> None:
        """Count jumps of time; ``place`` is where the first of them is."""
        self._first_jump = self._first_jump or place
        self._jumps_back += back
        self._jumps_ahead += ahead

    def take(self, counts: LogCounts) -> None:
        """Add what another reader of the same log counted."""
        self.frames += counts.frames
        self.skipped += counts.skipped
        self.truncated |= counts.truncated
        self.unfinished |= counts.unfinished
        self._first_rejected = self._first_rejected or counts.first_rejected
        self._rejected.update(counts.rejected)
        for text in counts.notes:
            self.note(text)

    def snapshot(self) -> LogCounts:
        """Return the counts of now."""
        return LogCounts(
            frames=self.frames,
            skipped=self.skipped,
            rejected=dict(self._rejected),
            first_rejected=self._first_rejected,
            truncated=self.truncated,
            jumps_back=self._jumps_back,
            jumps_ahead=self._jumps_ahead,
            first_jump=self._first_jump,
            repeated=self.repeated,
            unfinished=self.unfinished,
            notes=tuple(self._notes),
        )
