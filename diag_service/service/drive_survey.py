"""Estimates from a log as a whole: friction up to a scale, slope of a lock-up clutch, and implausible units."""

import logging

from clutch_results.records import Tier
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.lockup.slope import SlopeSurvey
from diag_service.diagnosis.prediction import RelativeFriction, RelativeSurvey
from diag_service.mapping.proposal import Ranges
from diag_service.service.stages import Stages

_LOG = logging.getLogger(__name__)


class DriveSurvey:
    """The survey of recorded drives; a live bus has none."""

    def __init__(self, stages: Stages) -> None:
        self._ranges = Ranges(stages.decoder.profile_sources)
        self._relative = RelativeSurvey() if stages.reach.is_relative else None
        self._gears = stages.decoder.gears
        self.slopes = SlopeSurvey(is_commanded=Signal.LOCKUP_PRESSURE not in stages.decoder.signals)
        if stages.reach.tier is Tier.TORQUE and stages.reach.asked["has_converter"]:
            stages.watch = self.slopes.feed

    def add(self, event: Event) -> None:
        self._ranges.add(event)
        if self._relative is not None:
            self._relative.add(event, self._gears)

    def relative_frictions(self) -> tuple[RelativeFriction, ...]:
        """Return friction up to a scale, and warn of implausible units."""
        for text in self._ranges.doubts():
            _LOG.warning("%s", text)
        return () if self._relative is None else self._relative.frictions()
