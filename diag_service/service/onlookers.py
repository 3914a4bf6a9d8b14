"""What those who look on at a live run are shown: where it stands, and its last shifts."""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from clutch_model.calibration import Calibration
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.records import ShiftResult
from diag_service.settings.config import ListenAddress

if TYPE_CHECKING:  # a report needs no bus
    from diag_service.service.snapshot import Board

MOST_SHIFTS: Final = 4  # with their signals, some hundred kilobytes each


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A shift with its signals."""

    event: Event
    result: ShiftResult


class LastShifts:
    """The last shifts of a run, the newest last; written by one thread, read by others."""

    def __init__(self, most: int = MOST_SHIFTS) -> None:
        self._kept: deque[Example] = deque(maxlen=most)

    @property
    def examples(self) -> Sequence[Example]:
        return tuple(self._kept)

    def add(self, event: Event, result: ShiftResult) -> None:
        """Keep a shift and forget the oldest."""
        self._kept.append(Example(event=own_samples(event), result=result))


def own_samples(event: Event) -> Event:
    """Return an event with samples of its own: those of the stream are written over."""
    return replace(event, columns={signal: series.copy() for signal, series in event.columns.items()})


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveRun:
    """A live run, as a page shows it."""

    vehicle: str
    source: str  # where frames are read from
    store: str  # where results are
    calibration: Calibration
    board: "Board"
    shifts: LastShifts


OpenPage = Callable[[ListenAddress, LiveRun], AbstractContextManager[str]]  # shows a run while entered; yields where
