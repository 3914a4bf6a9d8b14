"""What those who look on at a live run are shown: where it stands, and its last shifts."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from clutch_model.calibration import Calibration
from diag_service.service.last_shifts import LastShifts
from diag_service.service.snapshot import Board
from diag_service.settings.config import ListenAddress


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveRun:
    """A live run, as a page shows it."""

    vehicle: str
    source: str  # where frames are read from
    store: str  # where results are
    calibration: Calibration
    board: Board
    shifts: LastShifts


OpenPage = Callable[[ListenAddress, LiveRun], AbstractContextManager[str]]  # shows a run while entered; yields where
