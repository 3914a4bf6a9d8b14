"""Reporters of a run: the protocols of links and reporters, JSON lines, a reporter in memory."""

import logging
import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TextIO

from rich.console import Console

from clutch_results.records import FluidFill, ShiftResult, dump, shift_record
from diag_service.diagnosis.summary import Summary, summary_record
from fleet_contract import Outgoing, Receipt


class ControllerNews(ABC):
    """A report of a controller on its trouble codes; ``str`` returns a line for people."""

    @property
    @abstractmethod
    def record(self) -> Mapping[str, object]:
        """The public record that stores and messages hold."""


# Where frames are read from; then each shift, and what a controller says that is new; at the end the numbers.
News = str | ShiftResult | ControllerNews | Summary


@dataclass(frozen=True, slots=True, kw_only=True)
class DeliveryLimits:
    """Times and counts of an outbox; what stands here suits a vehicle on a mobile link."""

    first_pause_s: float = 0.5  # after a connection broke; doubled with each further failure
    longest_pause_s: float = 30.0
    restart_pause_s: float = 1.0  # after the sending itself failed, which it should not
    settled_after_s: float = 5.0  # then a result that a broker acknowledged is taken to be where it belongs
    resend_after_s: float = 5.0  # without a receipt
    longest_resend_s: float = 30.0  # while all is silent a few are sent again, less and less often up to this
    backlog_lag_s: float = 2.0  # so far behind a backend may be before it gets more of the backlog
    window_count: int = 2000  # results in flight: sent, without a receipt
    answer_s: float = 5.0  # a fleet has to tell its fluid fills before the results of a log are made without them
    probe_count: int = 20  # results that ask a silent backend whether it is there; the others wait for its word


class OnReceipts(Protocol):
    """Callback for acknowledgements of a backend."""

    def __call__(self, receipts: list[Receipt], *, takes_bundles: bool = False) -> None:
        """Take receipts, and whether who gave them takes several results in one message."""


class OnFills(Protocol):
    """Callback for fluid fills that the fleet knows."""

    def __call__(self, fills: list[FluidFill], *, is_answer: bool = True) -> None:
        """Take what the fleet knows, and whether it knows that now: a broker keeps what it once knew."""


class Link(Protocol):
    """An open connection to a broker; the outbox opens one, uses it while it lasts, and opens the next."""

    async def send(self, messages: Sequence[Outgoing]) -> None:
        """Deliver messages, several in flight; return when the broker acknowledged all.

        Raises
        ------
        PublishRefusedError, PublishError
            If the broker takes one of them never; if it cannot be delivered now.
        """

    async def listen(self, vehicle: str, on_receipts: OnReceipts) -> None:
        """Call ``on_receipts`` with the receipts of a backend from now on; raises PublishError if that is refused."""

    async def hear_fills(self, vehicle: str, on_fills: OnFills) -> None:
        """Call ``on_fills`` with the fluid fills that the fleet knows from now on, as far as the broker lets us."""

    async def lost(self) -> None:
        """Return when the connection is lost, or when a better one could be had."""


class Reporter(Protocol):
    """Shows a run to the person or program that started it; may block, so it runs in the worker thread."""

    def report(self, news: News) -> None:
        """Show one of the news; the numbers of the run are the last of them."""


class MemoryReporter:
    """A reporter that keeps results and summaries."""

    def __init__(self) -> None:
        self.results: list[ShiftResult] = []
        self.summaries: list[Summary] = []

    def report(self, news: News) -> None:
        if isinstance(news, ShiftResult):
            self.results.append(news)
        elif isinstance(news, Summary):
            self.summaries.append(news)


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
        for reporter in self._reporters:
            reporter.report(news)
