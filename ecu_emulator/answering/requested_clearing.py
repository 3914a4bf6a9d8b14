"""Clearing what was learned of the clutches, as a tester asks for it after a change of the fluid (service 31).

The estimate on board begins anew with the new fluid, and touch points are those of the type; until both are known
again, P0810 says so.
"""

from concurrent.futures import Future, ThreadPoolExecutor

from ecu_emulator.answering.monitoring import Monitoring
from ecu_emulator.answering.on_board import OpinionSource
from ecu_emulator.answering.requested_adaptation import RequestedAdaptation
from ecu_emulator.answering.requested_routine import running_routine
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.descriptions import Task


class RequestedClearing:
    """Has the estimate begin anew when a routine asks for it, and ends the routine once that is done or has failed.

    Parameters
    ----------
    source
        Where the controller's opinion of its clutches comes from.
    controller
        Whose routines are looked after.
    monitoring
        Notes what was cleared.
    adaptation
        Forgets the touch points; None: there are none that were adapted.
    """

    def __init__(
        self,
        source: OpinionSource,
        controller: Controller,
        monitoring: Monitoring,
        adaptation: RequestedAdaptation | None = None,
    ) -> None:
        self._source = source
        self._adaptation = adaptation
        self._controller = controller
        self._monitoring = monitoring
        self._pool = ThreadPoolExecutor(1, "clearing")
        self._work: Future[bool] | None = None

    @property
    def is_possible(self) -> bool:
        """Whether there is something to clear: an estimate on board that can begin anew, or adapted touch points."""
        return self._source.problem is None if self._source.is_live else self._adaptation is not None

    def step(self) -> None:
        """Do what is due; to be called about ten times a second, never waits."""
        found = running_routine(self._controller, Task.NEW_FLUID)
        if self._work is None:
            if found is not None:
                self._work = self._pool.submit(self._clear)
            return
        if not self._work.done():
            return
        is_cleared, self._work = self._work.result(), None
        if is_cleared:  # also if the tester has gone meanwhile
            self._monitoring.note_cleared()
        if found is not None and is_cleared:
            self._controller.finish(found[0])
        elif found is not None:
            self._controller.fail(found[0])

    def _clear(self) -> bool:
        """Clear what there is, the estimate first: it may not be able to."""
        is_begun = not self._source.is_live or self._source.begin_anew()
        return is_begun and (self._adaptation is None or self._adaptation.forget(awaits_estimate=self._source.is_live))

    def close(self) -> None:
        """Wait until nothing is under way any more."""
        self._pool.shutdown()
