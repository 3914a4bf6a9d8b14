"""A live diagnosis in a thread of its own, for tests and programs that have no event loop."""

import asyncio
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from diag_service.api.analysis import Analysis
from diag_service.diagnosis.records import ShiftResult
from diag_service.diagnosis.summary import FrameCounts
from diag_service.tester.trouble_report import ControllerReport

if TYPE_CHECKING:
    from diag_service.api.live import LiveDiagnosis

POLL_S = 0.01


class BackgroundDiagnosis:
    """A bus that is diagnosed while the ``with`` block runs; made by ``LiveDiagnosis.in_background``.

    When the block begins the bus is listened to. What goes wrong later is raised by ``wait_for`` and ``stop``, and at
    the end of a block that has not failed itself.
    """

    def __init__(self, diagnosis: "LiveDiagnosis") -> None:
        self._diagnosis = diagnosis
        self._thread = threading.Thread(target=self._work, name="live diagnosis", daemon=True)
        self._is_begun = threading.Event()
        self._error: BaseException | None = None

    def __enter__(self) -> Self:
        self._thread.start()
        self._is_begun.wait()
        self._raise()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._diagnosis.stop()
        self._thread.join()
        if error is None:
            self._raise()

    @property
    def results(self) -> tuple[ShiftResult, ...]:
        """The shifts that were found until now."""
        return tuple(self._diagnosis.results)

    @property
    def controller_reports(self) -> tuple[ControllerReport, ...]:
        """What the controller said of its trouble codes until now, as ``LiveDiagnosis`` has it."""
        return tuple(self._diagnosis.controller_reports)

    @property
    def frames(self) -> FrameCounts:
        """What became of the frames until now."""
        return self._diagnosis.frames

    @property
    def analysis(self) -> Analysis:
        """All results and numbers until now."""
        return self._diagnosis.analysis

    def wait_for(self, shift_count: int, timeout_s: float) -> tuple[ShiftResult, ...]:
        """Return the shifts as soon as there are so many.

        Raises
        ------
        TimeoutError
            If there are fewer after this time; it says how many, and what became of the frames.
        SourceError, StoreError, ...
            What ended the diagnosis.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            has_ended = not self._thread.is_alive()  # asked first: what comes after that is seen by the next look
            if len(self._diagnosis.results) >= shift_count:
                return self.results
            if has_ended:
                self._raise()
                raise TimeoutError(f"the diagnosis has ended with {self._said}")
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"after {timeout_s:g} s {self._said}, {shift_count} were waited for")
            time.sleep(POLL_S)

    def stop(self) -> Analysis:
        """End the diagnosis with what was received until now, and return all of it."""
        self._diagnosis.stop()
        self._thread.join()
        self._raise()
        return self.analysis

    @property
    def _said(self) -> str:
        frames = self.frames
        return f"{len(self._diagnosis.results)} shifts, {frames.on_bus} frames, {frames.decoded} decoded"

    def _work(self) -> None:
        try:
            asyncio.run(self._listen())
        except BaseException as exc:  # noqa: BLE001 - carried to the thread that waits
            self._error = exc
        finally:
            self._is_begun.set()

    async def _listen(self) -> None:
        async with self._diagnosis:
            self._is_begun.set()
            async for _ in self._diagnosis:
                pass

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error
