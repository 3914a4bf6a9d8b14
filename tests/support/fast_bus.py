"""``diag-service run`` on a bus that plays a log many times faster than real time, with the log's own times.

``python -m tests.support.fast_bus LOG START_NS run ...``: the bus begins with the first frame at or after START_NS and
falls silent at the end of the log. All but the bus is the service as it is: a crash, a store and a broker are real.
"""

import asyncio
import sys
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from canlog.frames import FrameBatch, join
from canlog.live import FrameSource, SourceCounts
from canlog.logs import read_log
from diag_service import cli

SPEED_RATIO = 10.0
SLICE_NS = 50_000_000  # as often as a live source hands over frames


class FastBus:
    """The frames of a log from a moment on, as a live source."""

    def __init__(self, log: Path, start_ns: int) -> None:
        whole = join(list(read_log(log)))
        self._frames = whole[int(np.searchsorted(whole.t_ns, start_ns)) :]
        self._received = 0
        self._closed = asyncio.Event()
        self.description = f"fast bus {log.name}"

    @property
    def counts(self) -> SourceCounts:
        """What has been handed over."""
        return SourceCounts(received=self._received)

    async def __aiter__(self) -> AsyncIterator[FrameBatch]:
        """Iterate over the batches, in their time."""
        t_ns = self._frames.t_ns
        edges = np.searchsorted(t_ns, np.arange(t_ns[0], t_ns[-1] + SLICE_NS, SLICE_NS)).tolist()
        for first, stop in zip(edges, [*edges[1:], len(t_ns)], strict=True):
            if self._closed.is_set():
                return
            self._received += stop - first
            yield self._frames[first:stop]
            await asyncio.sleep(SLICE_NS / 1e9 / SPEED_RATIO)
        await self._closed.wait()

    async def aclose(self) -> None:
        """Fall silent."""
        self._closed.set()


class FastBusOpener:
    """Stand in for ``BusOpener``."""

    counts_duration = False

    def __init__(self, log: Path, start_ns: int, *_settings: object, **_options: object) -> None:
        self._log = log
        self._start_ns = start_ns

    async def open(self) -> FrameSource:
        """Open the bus."""
        return FastBus(self._log, self._start_ns)

    async def restart(self) -> str | None:
        """Refuse: it has no controller."""
        return "no controller"


if __name__ == "__main__":
    with patch("diag_service.service.bus_run.BusOpener", partial(FastBusOpener, Path(sys.argv[1]), int(sys.argv[2]))):
        sys.exit(cli.main(sys.argv[3:]))
