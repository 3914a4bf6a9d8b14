"""A reporter whose listener may hang up, as ``head`` does."""

from collections.abc import Callable

from diag_service.delivery.base import Reporter
from diag_service.diagnosis.records import ShiftResult
from diag_service.diagnosis.summary import Summary


class PipeReporter:
    """Passes everything on until the pipe breaks; says so once and is silent from then on."""

    def __init__(self, reporter: Reporter, on_break: Callable[[], None]) -> None:
        self._reporter = reporter
        self._on_break = on_break
        self._is_broken = False

    def listening(self, where: str) -> None:
        """Say that frames are being read."""
        self._try(lambda: self._reporter.listening(where))

    def report(self, result: ShiftResult) -> None:
        """Tell of one shift."""
        self._try(lambda: self._reporter.report(result))

    def finish(self, summary: Summary) -> None:
        """Tell the numbers of the run."""
        self._try(lambda: self._reporter.finish(summary))

    def _try(self, tell: Callable[[], None]) -> None:
        if self._is_broken:
            return
        try:
            tell()
        except BrokenPipeError:
            self._is_broken = True
            self._on_break()
