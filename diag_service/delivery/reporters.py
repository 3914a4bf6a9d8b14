"""Reporters for programs: JSON lines in a pipe, of which the reader may hang up or be slow."""

import logging
import queue
import threading
from collections.abc import Callable
from typing import Final, TextIO

from rich.console import Console

from diag_service.delivery.base import ControllerNews, News, Reporter
from diag_service.diagnosis.records import ShiftResult, dump, shift_record
from diag_service.diagnosis.summary import Summary, summary_record

LIMIT: Final = 1_000  # results that a slow reader may be behind
DRAIN_S: Final = 3.0  # how long an ending service waits for a reader
_LOG = logging.getLogger(__name__)


class JsonLinesReporter:
    """Writes a record per shift, per word of a controller and one at the end, each on a line; texts elsewhere."""

    def __init__(self, stream: TextIO, people: Console) -> None:
        self._stream = stream
        self._people = people

    def report(self, news: News) -> None:
        """Write one record at once, or tell people where frames are read from."""
        if isinstance(news, str):
            self._people.print(f"listening on {news}", highlight=False, markup=False, soft_wrap=True)
            return
        if isinstance(news, ControllerNews):
            record = news.record
        else:
            record = shift_record(news) if isinstance(news, ShiftResult) else summary_record(news)
        self._stream.write(dump(record) + "\n")
        self._stream.flush()


class PipeReporter:
    """Passes everything on until the reader hangs up, as ``head`` does; says so once and is silent from then on."""

    def __init__(self, reporter: Reporter, on_break: Callable[[], None]) -> None:
        self._reporter = reporter
        self._on_break = on_break
        self._is_broken = False

    def report(self, news: News) -> None:
        """Pass on one piece of news."""
        if self._is_broken:
            return
        try:
            self._reporter.report(news)
        except BrokenPipeError:
            self._is_broken = True
            self._on_break()


class DetachedReporter:
    """Passes everything on in a thread of its own, in order; what finds no room is counted and left out.

    A reporter that raises costs what it was given, nothing else. Results are in the store whatever happens here.
    """

    def __init__(self, reporter: Reporter, *, limit: int = LIMIT, drain_s: float = DRAIN_S) -> None:
        self._reporter = reporter
        self._drain_s = drain_s
        self._news: queue.Queue[News] = queue.Queue(limit)
        self.dropped = 0  # what was left out because the reporter did not keep up
        self.failed = 0  # what the reporter raised an error over
        self._thread = threading.Thread(target=self._work, name="reporter", daemon=True)

    def report(self, news: News) -> None:
        """Pass on one piece of news, and after the last wait a little until everything is shown."""
        if self._thread.ident is None:
            self._thread.start()
        try:
            self._news.put(news, timeout=self._drain_s if isinstance(news, Summary) else 0.0)
        except queue.Full:
            self.dropped += 1
            if self.dropped == 1:
                _LOG.warning("the reader of the results is %d behind; some are left out", self._news.maxsize)
        if isinstance(news, Summary):
            self._thread.join(self._drain_s)
            if self._thread.is_alive():
                _LOG.warning("the reader of the results does not accept them; they stay in the store")

    def _work(self) -> None:
        news: News = ""
        while not isinstance(news, Summary):
            news = self._news.get()
            try:
                self._reporter.report(news)
            except Exception as exc:  # noqa: BLE001 - whatever goes wrong there must go no further
                self.failed += 1
                _LOG.warning("a result was stored, but could not be told: %s", " ".join(str(exc).split()))


class AllReporters:
    """Passes everything on to several reporters, in their order."""

    def __init__(self, *reporters: Reporter) -> None:
        self._reporters = reporters

    def report(self, news: News) -> None:
        """Pass on one piece of news."""
        for reporter in self._reporters:
            reporter.report(news)
