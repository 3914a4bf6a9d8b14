"""A reporter that has its own thread: whatever the one behind it does, the service goes on."""

import logging
import queue
import threading
from collections.abc import Callable

from diag_service.delivery.base import Reporter
from diag_service.diagnosis.records import ShiftResult
from diag_service.diagnosis.summary import Summary

LIMIT = 1_000  # results that a slow reader may be behind
DRAIN_S = 3.0  # how long an ending service waits for a reader
_LOG = logging.getLogger(__name__)


class DetachedReporter:
    """Passes everything on, in order, without waiting; what finds no room is counted and left out.

    A reporter that raises costs what it was told, nothing else. Results are in the store whatever happens here.
    """

    def __init__(self, reporter: Reporter, *, limit: int = LIMIT, drain_s: float = DRAIN_S) -> None:
        self._reporter = reporter
        self._drain_s = drain_s
        self._tasks: queue.Queue[Callable[[], None] | None] = queue.Queue(limit)
        self._dropped = 0
        self._failed = 0
        self._thread: threading.Thread | None = None

    @property
    def dropped(self) -> int:
        """What was left out because the reporter did not keep up."""
        return self._dropped

    @property
    def failed(self) -> int:
        """What the reporter raised an error over."""
        return self._failed

    def listening(self, where: str) -> None:
        """Say that frames are being read."""
        self._pass_on(lambda: self._reporter.listening(where))

    def report(self, result: ShiftResult) -> None:
        """Tell of one shift."""
        self._pass_on(lambda: self._reporter.report(result))

    def finish(self, summary: Summary) -> None:
        """Tell the numbers of the run, and wait a little until everything is told."""
        self._pass_on(lambda: self._reporter.finish(summary))
        self._pass_on(None)
        if self._thread is not None:
            self._thread.join(self._drain_s)
            if self._thread.is_alive():
                _LOG.warning("whoever reads the results does not take them; they are in the store")

    def _pass_on(self, task: Callable[[], None] | None) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="reporter", daemon=True)
            self._thread.start()
        try:
            self._tasks.put_nowait(task)
        except queue.Full:
            self._dropped += 1
            if self._dropped == 1:
                _LOG.warning("whoever reads the results is %d behind; leaving some out", self._tasks.maxsize)

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            try:
                task()
            except Exception as exc:  # noqa: BLE001 - whatever goes wrong there must go no further
                self._failed += 1
                _LOG.warning("a result was stored, but could not be told: %s", " ".join(str(exc).split()))
