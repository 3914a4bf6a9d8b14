"""A live bus that comes back: the source that reads it is opened again, for as long as it takes."""

import asyncio
import logging
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Protocol

from canlog.errors import NOTICE, SourceError
from canlog.frames import FrameBatch
from canlog.live.bus_state import BusState, BusStatus, BusWatch
from canlog.live.sources import FrameSource, LinkBreak, Silence, SourceCounts
from canlog.traffic import frame_bits

RETRY_S = 0.1  # from the return of the interface to its first frame: this and the opening
LONGEST_RETRY_S = 1.0  # for a bus that opens, but fails before it gave anything
RESTART_PERIOD_S = 1.0
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

    retry_s: float = RETRY_S
    longest_retry_s: float = LONGEST_RETRY_S
    restart_s: float = RESTART_PERIOD_S


class SupervisedSource:
    """The frames of a bus over all its openings, with a ``LinkBreak`` wherever it was away.

    Frames received before a failure come first, then the break, then what is heard after the return. Iteration ends
    with ``aclose`` only.
    """

    def __init__(self, opener: Opener, first: FrameSource, backoff: Backoff | None = None) -> None:
        self._opener = opener
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

    async def __aiter__(self) -> AsyncIterator[FrameBatch | Silence | LinkBreak]:
        """Iterate over batches, silences and breaks."""
        while self._source is not None:
            try:
                async for part in self._source:
                    if not isinstance(part, Silence):
                        self._note(part)
                    yield part
            except SourceError as exc:
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
            self._watch.count_restart()
            if refusal is None:
                _LOG.log(NOTICE, "%s is bus-off; asked it to restart", self.description)
            elif refusal != last_refusal:
                _LOG.warning("%s is bus-off and cannot be restarted from here: %s", self.description, refusal)
            last_refusal = refusal
            await asyncio.sleep(self._backoff.restart_s)


async def supervise(opener: Opener) -> SupervisedSource:
    """Open a bus for the first time and keep it open from then on.

    Raises
    ------
    SourceError
        If it cannot be opened now: a service that never heard its bus was most likely told the wrong one.
    """
    return SupervisedSource(opener, await opener.open())


def _now_s() -> float:
    return asyncio.get_running_loop().time()


async def _first_of(event: asyncio.Event, timeout_s: float) -> None:
    try:
        async with asyncio.timeout(timeout_s):
            await event.wait()
    except TimeoutError:
        return
