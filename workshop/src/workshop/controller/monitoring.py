"""Samples of the monitors become test results in the controller's memory."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from clutch_model.calibration import CONVERTERS
from ecu_emulator.errors import RecordError
from ecu_emulator.plant.parameters import nominal_parameters
from workshop.controller import clutches
from workshop.controller.controller import Controller
from workshop.controller.descriptions import Values
from workshop.controller.iso14229 import DtcStatus
from workshop.controller.memory import TestResult
from workshop.controller.monitors import MonitorLimits, MonitorState, is_warm, judge

MONITOR_PERIOD_S: Final = 0.1


class Monitoring:
    """Judges the vehicle for one controller.

    Parameters
    ----------
    controller
        Stores the results; codes that its table lacks are not tested.
    was_adapted
        Whether it knew its clutches' touch points at its start.
    transmission
        Type of the transmission.
    """

    def __init__(self, controller: Controller, *, was_adapted: bool = True, transmission: str = "nominal") -> None:
        self._controller = controller
        self._was_adapted = was_adapted
        self._numbers = {trouble.code: number for number, trouble in controller.table.troubles.items()}
        self._watch = MonitorState()
        self._limits = MonitorLimits(
            most_clutch_k=controller.table.clutches.most_temperature_k,
            input_output_ratios=nominal_parameters(transmission).gearbox.input_output_ratios,
            packs=clutches.packs_of(transmission),
            has_converter=transmission in CONVERTERS,
        )
        self._adaptation = controller.state.adaptation
        self.problem: str | None = None  # why something could not be kept, for people

    @property
    def temperatures(self) -> dict[str, float]:
        """Computed temperatures of the clutches by source [K]."""
        found_k = self._watch.clutches_k
        return {} if found_k is None else {"clutch1_temperature_k": found_k[0], "clutch2_temperature_k": found_k[1]}

    def judge(self, values: Values, t_s: float) -> None:
        """Judge the values at this moment of the drive; called about ten times a second."""
        self._watch, samples = judge(self._watch, values, t_s, self._limits)
        self._report(dict(samples), has_warmed_up=is_warm(self._watch, values))

    def restart(self, *, is_new_cycle: bool) -> None:
        """Reset the monitors, as at power-on; a new operation cycle may begin with it."""
        self._watch = MonitorState()
        if is_new_cycle:
            self._keep(self._controller.cycle)

    def judge_adaptation(self) -> None:
        """Test the adaptation when it has changed, and once in every operation cycle."""
        adaptation = self._controller.state.adaptation
        is_changed = adaptation is not self._adaptation
        self._adaptation = adaptation
        results = {
            clutches.ADAPTATION_CODE: clutches.adaptation_test(adaptation, was_adapted=self._was_adapted),
            clutches.LIMIT_CODE: clutches.limit_test(adaptation),
        }
        self._report(
            {
                code: result
                for code, result in results.items()
                if result is not None and (is_changed or self._is_untested(code))
            }
        )

    def _is_untested(self, code: str) -> bool:
        """Return whether a test has not run in this operation cycle."""
        records, number = self._controller.state.memory.records, self._numbers.get(code)
        return number is not None and bool(records[number].status & DtcStatus.NOT_TESTED_THIS_CYCLE)

    def _report(self, results: Mapping[str, TestResult], *, has_warmed_up: bool = False) -> None:
        """Report results; one that cannot be saved is tried again with the next sample."""
        for number, result in (
            (self._numbers[code], result) for code, result in results.items() if code in self._numbers
        ):
            self._keep(partial(self._controller.report, number, result))
        if has_warmed_up:
            self._keep(self._controller.warm_up)

    def _keep(self, change: Callable[[], None]) -> None:
        """Call a change of the controller; the drive goes on if it cannot be saved."""
        try:
            change()
        except RecordError as exc:
            self.problem = self.problem or str(exc)
