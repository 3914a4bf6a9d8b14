"""Launches whose clutch slips again after it had stuck: a witness for the sign of the slope that needs no torque.

Friction that falls with the slip lets a soft driveline swing as a clutch sticks. A launch without it says nothing: with
little load worn fluid does not swing either. docs/verdict.md, "Launches that judder".
"""

from dataclasses import dataclass, replace
from typing import Final, Self

from diag_service.diagnosis.events import EndReason, EventKind
from diag_service.diagnosis.records import ShiftEstimate, StickSlip

JUDDER_RAD_S: Final = 5.2  # slip after the clutch had stuck: 5, and a little of what the noise of its speeds adds
LAUNCH_WINDOW: Final = 20  # launches of a clutch that are remembered
LEAST_COUNT: Final = 2  # a single one may be a load that pulled the clutch open
EVIDENCE_RATIO: Final = 10.0  # for each beyond the first: half of the launches of aged fluid, none of 102 of others
MOST_EVIDENCE_RATIO: Final = 20.0  # drivelines differ: a witness that nobody has calibrated does not decide alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Launches:
    """Which of the last launches of one clutch juddered, the oldest first."""

    juddered: tuple[bool, ...] = ()

    def with_event(self, estimate: ShiftEstimate) -> Self:
        """Return what is remembered after an event: a launch to lock whose slip is known counts, nothing else."""
        indices = estimate.indices
        if estimate.kind is not EventKind.LAUNCH or estimate.end_reason is not EndReason.COMPLETE:
            return self
        if indices is None or indices.reslip_rad_s is None:
            return self
        return replace(self, juddered=(*self.juddered, indices.reslip_rad_s > JUDDER_RAD_S)[-LAUNCH_WINDOW:])

    @property
    def reported(self) -> StickSlip | None:
        """What is said of them; None before there is one."""
        if not self.juddered:
            return None
        return StickSlip(launch_count=len(self.juddered), judder_count=sum(self.juddered))

    @property
    def speak(self) -> bool:
        """Whether enough of them juddered to say something of the slope."""
        return sum(self.juddered) >= LEAST_COUNT

    @property
    def text(self) -> str:
        """What they say, for people."""
        return f"{sum(self.juddered)} of {len(self.juddered)} launches juddered"

    def probability_negative(self, by_friction: float) -> float:
        """Return the probability of a negative slope, given what friction alone says of it."""
        if not self.speak:
            return by_friction
        ratio = min(EVIDENCE_RATIO ** (sum(self.juddered) - 1), MOST_EVIDENCE_RATIO)
        return by_friction * ratio / (by_friction * ratio + 1.0 - by_friction)
