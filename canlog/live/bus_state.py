"""The state of a bus as a listener sees it: from its frames, its error frames, its losses and its absence."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from canlog.frames import GOOD_NEWS, BusTrouble, FrameBatch, count_errors, is_error, reports

TROUBLE_S = 5.0  # how long an error frame or a loss is remembered as trouble


class BusState(StrEnum):
    """Whether frames can be had from a bus."""

    UP = "up"
    DEGRADED = "degraded"  # frames come, but some were lost or the controller complained lately
    DOWN = "down"  # the interface is switched off, gone or does not answer
    BUS_OFF = "bus_off"  # the controller has cut itself off
    RESTARTED = "restarted"  # interface or controller are back; nothing was heard yet


@dataclass(frozen=True, slots=True, kw_only=True)
class BusStatus:
    """State of a bus and what has happened to it."""

    state: BusState
    errors: Mapping[BusTrouble, int]  # error frames by what they tell
    interruption_count: int  # times that the interface was lost
    restart_count: int  # restarts asked of the controller
    last_problem: str | None


class BusWatch:
    """Follows the state of one bus; times are monotonic seconds and never go back."""

    def __init__(self) -> None:
        self._state = BusState.UP
        self._errors: Counter[BusTrouble] = Counter()
        self._interruption_count = 0
        self._restart_count = 0
        self._last_problem: str | None = None
        self._dropped = 0
        self._trouble_s: float | None = None

    @property
    def is_off(self) -> bool:
        """Whether the controller has cut itself off."""
        return self._state is BusState.BUS_OFF

    def add_frames(self, batch: FrameBatch, dropped: int, now_s: float) -> None:
        """Take note of frames; ``dropped`` counts all that were lost on this side until now."""
        if dropped > self._dropped:
            self._dropped = dropped
            self._trouble_s = now_s
        found = count_errors(batch)
        if not found:
            self._state = BusState.UP
            return
        self._errors.update(found)
        if found.keys() - GOOD_NEWS:
            self._trouble_s = now_s
        self._state = self._latest(batch)
        if self._state is BusState.BUS_OFF:
            self._last_problem = "the controller went bus-off"

    def mark_lost(self, problem: str) -> None:
        """Take note that the interface is not there any more."""
        self._state = BusState.DOWN
        self._interruption_count += 1
        self._last_problem = problem

    def mark_back(self) -> None:
        """Take note that the interface can be read again."""
        self._state = BusState.RESTARTED

    def count_restart(self) -> None:
        """Take note that the controller was asked to restart."""
        self._restart_count += 1

    def status(self, now_s: float) -> BusStatus:
        is_troubled = self._trouble_s is not None and now_s - self._trouble_s < TROUBLE_S
        state = BusState.DEGRADED if self._state is BusState.UP and is_troubled else self._state
        return BusStatus(
            state=state,
            errors=MappingProxyType(dict(self._errors)),
            interruption_count=self._interruption_count,
            restart_count=self._restart_count,
            last_problem=self._last_problem,
        )

    def _latest(self, batch: FrameBatch) -> BusState:
        """Return the state that the last telling frame of a batch with error frames leaves."""
        news = {
            BusState.UP: ~is_error(batch),
            BusState.BUS_OFF: reports(batch, BusTrouble.BUS_OFF),
            BusState.RESTARTED: reports(batch, BusTrouble.RESTARTED),
        }
        rows = {state: int(np.flatnonzero(told)[-1]) for state, told in news.items() if told.any()}
        return max(rows, key=lambda state: rows[state], default=self._state)
