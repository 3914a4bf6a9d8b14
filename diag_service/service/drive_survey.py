"""Estimates from a log as a whole: friction up to a scale, slope of a lock-up clutch, and implausible units."""

import logging

from clutch_results.records import Tier
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.lockup.slip import LockupSlip, SlipSurvey
from diag_service.diagnosis.lockup.slope import SlopeSurvey
from diag_service.diagnosis.prediction import RelativeFriction, RelativeSurvey
from diag_service.mapping.learning import BEHIND, VehicleSurvey
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
        self._slips = SlipSurvey()
        self._has_slips = stages.reach.tier is Tier.KINEMATIC and stages.reach.asked["has_converter"]
        self._has_slopes = stages.reach.tier is Tier.TORQUE and stages.reach.asked["has_converter"]
        signals = stages.decoder.signals
        over = next((speed for speed in BEHIND if speed in signals), None)
        self._vehicle = None if over is None else VehicleSurvey(over)
        stages.watch = self._watch

    def _watch(self, columns: ColumnBatch) -> None:
        if self._has_slopes:
            self.slopes.feed(columns)
        if self._has_slips:
            self._slips.feed(columns)
        if self._vehicle is not None:
            self._vehicle.add(columns)

    def add(self, event: Event) -> None:
        if event.from_gear != event.to_gear:
            self._vehicle = None  # this is no run in one gear
        self._ranges.add(event)
        if self._relative is not None:
            self._relative.add(event, self._gears)

    def slip(self) -> LockupSlip | None:
        """Return what the slip of a lock-up clutch did, where nothing else is known of it."""
        return self._slips.slip() if self._has_slips else None

    @property
    def held_run(self) -> str:
        """What a clutch carried in a drive in one gear, for people; empty if it was another drive."""
        return "" if self._vehicle is None else self._vehicle.learned().held_run

    def relative_frictions(self) -> tuple[RelativeFriction, ...]:
        """Return friction up to a scale, and warn of implausible units."""
        for text in self._ranges.doubts():
            _LOG.warning("%s", text)
        return () if self._relative is None else self._relative.frictions()
