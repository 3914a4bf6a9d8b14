"""Clearing what was learned of the clutches, as a tester asks for it after a change of the fluid (service 31).

The estimate on board begins anew with the new fluid; until it knows the friction of both clutches again, P0810 says so.
"""

from concurrent.futures import Future, ThreadPoolExecutor

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.descriptions import Task
from ecu_emulator.monitoring import Monitoring
from ecu_emulator.on_board import OpinionSource
from ecu_emulator.requested_routine import running_routine


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
    """

    def __init__(self, source: OpinionSource, controller: Controller, monitoring: Monitoring) -> None:
        self._source = source
        self._controller = controller
        self._monitoring = monitoring
        self._pool = ThreadPoolExecutor(1, "clearing")
        self._work: Future[bool] | None = None

    @property
    def is_possible(self) -> bool:
        """Whether there is an estimate on board that can begin anew."""
        return self._source.is_live and self._source.problem is None

    def step(self) -> None:
        """Do what is due; to be called about ten times a second, never waits."""
        found = running_routine(self._controller, Task.NEW_FLUID)
        if self._work is None:
            if found is not None:
                self._work = self._pool.submit(self._source.begin_anew)
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

    def close(self) -> None:
        """Wait until nothing is under way any more."""
        self._pool.shutdown()
