"""A live bus that comes back: the source that reads it is opened again, for as long as it takes."""

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Protocol

import numpy as np

from canlog.errors import NOTICE, SourceError
from canlog.frames import GOOD_NEWS, BusTrouble, FrameBatch, count_errors, is_error, reports
from canlog.live.sources import BusSilence, FrameSource, LinkBreak, SourceCounts
from canlog.traffic import frame_bits

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
    errors: Mapping[BusTrouble, int]  # error frames by kind
    interruption_count: int  # times that the interface was lost
    restart_count: int  # restarts asked of the controller
    last_problem: str | None


class BusWatch:
    """Follows the state of one bus; times are monotonic seconds and never go back."""

    def __init__(self) -> None:
        self._state = BusState.UP
        self._errors: Counter[BusTrouble] = Counter()
        self._interruption_count = 0
        self.restart_count = 0  # restarts asked of the controller
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
        errors = count_errors(batch)
        if not errors:
            self._state = BusState.UP
            return
        self._errors.update(errors)
        if errors.keys() - GOOD_NEWS:
            self._trouble_s = now_s
        self._state = self._latest(batch)
        if self._state is BusState.BUS_OFF:
            self._last_problem = "the controller went bus-off"

    def mark_lost(self, problem: str) -> None:
        self._state = BusState.DOWN
        self._interruption_count += 1
        self._last_problem = problem

    def mark_back(self) -> None:
        self._state = BusState.RESTARTED

    def status(self, now_s: float) -> BusStatus:
        is_troubled = self._trouble_s is not None and now_s - self._trouble_s < TROUBLE_S
        state = BusState.DEGRADED if self._state is BusState.UP and is_troubled else self._state
        return BusStatus(
            state=state,
            errors=MappingProxyType(dict(self._errors)),
            interruption_count=self._interruption_count,
            restart_count=self.restart_count,
            last_problem=self._last_problem,
        )

    def _latest(self, batch: FrameBatch) -> BusState:
        """Return the state after the last frame of a batch that changes it."""
        news = {
            BusState.UP: ~is_error(batch),
            BusState.BUS_OFF: reports(batch, BusTrouble.BUS_OFF),
            BusState.RESTARTED: reports(batch, BusTrouble.RESTARTED),
        }
        rows = {state: int(np.flatnonzero(is_telling)[-1]) for state, is_telling in news.items() if is_telling.any()}
        return max(rows, key=lambda state: rows[state], default=self._state)


COUNT_PERIOD_S = 0.5  # how soon a loss shows in the state
_LOG = logging.getLogger(__name__)


class Opener(Protocol):
    """One bus that can be opened again and again."""

    async def open(self) -> FrameSource:
        """Open the bus; raise SourceError if it cannot be opened now."""

    async def restart(self) -> str | None:
        """Ask the controller to leave bus-off; return why that cannot be, None if it was accepted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Backoff:
    """How often is tried again [s]."""

    retry_s: float = 0.1  # from the return of the interface to its first frame: this and the opening
    longest_retry_s: float = 1.0  # for a bus that opens, but fails before it gave anything
    restart_s: float = 1.0


class SupervisedSource:
    """The frames of a bus over all its openings, with a ``LinkBreak`` wherever it was away.

    Frames received before a failure come first, then the break, then what is heard after the return. Iteration ends
    with ``aclose``, or after the duration for which a bus was opened; with ``is_once`` it fails when the bus does, with
    BusEndedError if that was its regular end.
    """

    def __init__(
        self, opener: Opener, first: FrameSource, backoff: Backoff | None = None, *, is_once: bool = False
    ) -> None:
        self._opener = opener
        self._is_once = is_once
        self._backoff = backoff or Backoff()
        self._source: FrameSource | None = first
        self.description = first.description
        self._past = SourceCounts()
        self._retry_s = self._backoff.retry_s
        self._watch = BusWatch()
        self.bit_count = 0.0  # of all frames on the bus, stuff bits estimated
        self._counted_s = -COUNT_PERIOD_S
        self._dropped = 0  # at the last count
        self._closing = asyncio.Event()
        self._restarter: asyncio.Task[None] | None = None

    @property
    def counts(self) -> SourceCounts:
        """What all openings together received and lost."""
        return self._past if self._source is None else self._past + self._source.counts

    @property
    def status(self) -> BusStatus:
        """State of the bus and what has happened to it."""
        return self._watch.status(_now_s())

    async def __aiter__(self) -> AsyncIterator[FrameBatch | BusSilence | LinkBreak]:
        """Iterate over batches, silences and breaks."""
        while self._source is not None:
            try:
                async for part in self._source:
                    if not isinstance(part, BusSilence):
                        self._note(part)
                    yield part
            except SourceError as exc:
                if self._is_once:
                    raise
                problem = str(exc)
            else:
                return
            await self._give_up(problem)
            yield LinkBreak(problem=problem)
            await self._reopen()

    async def aclose(self) -> None:
        """Stop receiving and trying; a second call does nothing."""
        self._closing.set()
        if self._restarter is not None:
            self._restarter.cancel()
        if self._source is not None:
            await self._source.aclose()

    def _note(self, batch: FrameBatch) -> None:
        now_s = _now_s()
        if now_s - self._counted_s > COUNT_PERIOD_S:  # a question to the kernel
            counts = self.counts
            self._counted_s, self._dropped = now_s, counts.kernel_dropped + counts.queue_dropped
        self.bit_count += float(frame_bits(batch).sum())
        self._retry_s = self._backoff.retry_s
        self._watch.add_frames(batch, self._dropped, now_s)
        if self._watch.is_off and (self._restarter is None or self._restarter.done()):
            self._restarter = asyncio.create_task(self._restart(), name="bus restart")

    async def _give_up(self, problem: str) -> None:
        self._watch.mark_lost(problem)
        _LOG.warning("%s; waiting for its return", problem)
        if self._source is not None:
            await self._source.aclose()
            self._past, self._source = self._past + self._source.counts, None

    async def _reopen(self) -> None:
        """Open the bus as soon as it can be opened, unless this is closed before."""
        lost_s = _now_s()
        await _first_of(self._closing, self._retry_s)
        while not self._closing.is_set():
            try:
                source = await self._opener.open()
            except SourceError as exc:
                _LOG.debug("not yet: %s", exc)
            else:
                self._source, self.description = source, source.description
                self._retry_s = min(2.0 * self._retry_s, self._backoff.longest_retry_s)
                self._watch.mark_back()
                _LOG.log(NOTICE, "%s is read again after %.1f s", source.description, _now_s() - lost_s)
                if self._closing.is_set():
                    await source.aclose()
                return
            await _first_of(self._closing, self._backoff.retry_s)

    async def _restart(self) -> None:
        """Ask for a restart, once in a while, until the controller is back on the bus."""
        last_refusal: str | None = None
        while self.status.state is BusState.BUS_OFF:
            refusal = await self._opener.restart()
            self._watch.restart_count += 1
            if refusal is None:
                _LOG.log(NOTICE, "%s is bus-off; asked it to restart", self.description)
            elif refusal != last_refusal:
                _LOG.warning("%s is bus-off and cannot be restarted from here: %s", self.description, refusal)
            last_refusal = refusal
            await asyncio.sleep(self._backoff.restart_s)


async def supervise(opener: Opener, *, is_once: bool = False) -> SupervisedSource:
    """Open a bus for the first time and keep it open from then on, unless it is to be read once.

    Raises
    ------
    SourceError
        If it cannot be opened now: most likely the wrong bus was named.
    """
    return SupervisedSource(opener, await opener.open(), is_once=is_once)


def _now_s() -> float:
    return asyncio.get_running_loop().time()


async def _first_of(event: asyncio.Event, timeout_s: float) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(timeout_s):
            await event.wait()
