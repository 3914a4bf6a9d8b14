"""What monitors and the estimate on board say of the vehicle becomes results of tests in the controller's memory."""

from collections.abc import Mapping
from typing import Final

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.monitors import Watch, is_warm, judge
from ecu_emulator.diagnostics.opinion import (
    ADAPTATION_CODE,
    FLUID_CODE,
    Opinions,
    adaptation_test,
    failed_codes,
    fluid_test,
)
from ecu_emulator.diagnostics.values import Values
from ecu_emulator.errors import RecordError

MONITOR_PERIOD_S: Final = 0.1


class Monitoring:
    """Judges the vehicle for one controller.

    Parameters
    ----------
    controller
        Who keeps the results; codes that its table does not have are not tested.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._numbers = {trouble.code: number for number, trouble in controller.table.troubles.items()}
        self._codes = {number: code for code, number in self._numbers.items()}
        self._watch = Watch()
        self._judged: Opinions | None = None
        self.problem: str | None = None  # why something could not be kept, for people

    def look(self, values: Values, t_s: float) -> None:
        """Let the monitors judge what the controllers say at this moment of the drive, about ten times a second."""
        self._watch, samples = judge(self._watch, values, t_s)
        self._report(dict(samples), has_warmed_up=is_warm(values))

    def judge_clutches(self, opinions: Opinions) -> None:
        """Let each new opinion of the clutches be a test, with the controller's values of that moment."""
        if opinions is self._judged:
            return
        self._judged = opinions
        failed = failed_codes(self._controller.state.memory.records, self._codes)
        results = {FLUID_CODE: fluid_test(opinions, failed), ADAPTATION_CODE: adaptation_test(opinions)}
        self._report({code: result for code, result in results.items() if result is not None})

    def note_cleared(self) -> None:
        """Note that what was learned of the clutches is cleared: that fails a test until they are known again."""
        self._report({ADAPTATION_CODE: TestResult.FAILED})

    def _report(self, results: Mapping[str, TestResult], *, has_warmed_up: bool = False) -> None:
        """Hand results on; what the disk does not take is tried again with the next sample, and the drive goes on."""
        try:
            for code, result in results.items():
                if code in self._numbers:
                    self._controller.report(self._numbers[code], result)
            if has_warmed_up:
                self._controller.warm_up()
        except RecordError as exc:
            self.problem = self.problem or str(exc)
