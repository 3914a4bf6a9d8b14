"""Whether what a controller is asked for means what a profile from public sources says: else nothing is estimated."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from diag_service.diagnosis.records import Reason, ShiftEstimate, Status

LEAST_RATIO, MOST_RATIO = 0.7, 1.25  # of the friction that the type has new: no fluid leaves these
SURE_STD: Final = 1.0
MOST_MISFITS: Final = 3  # without one event that fits
_MISFITS: Final = frozenset({Reason.MISFIT, Reason.SPEEDS_DISAGREE, Reason.IMPLAUSIBLE})


@dataclass(slots=True)
class MeaningCheck:
    """Looks at the estimates of a drive; ``doubt`` says what cannot be, empty as long as all of it can."""

    new_mu_c: Sequence[float]  # of the type, of both clutches
    doubt: str = ""
    _found: Counter[bool] = field(default_factory=Counter)  # events that fit, and that do not

    def is_believed(self, estimate: ShiftEstimate) -> bool:
        """Take the estimate of an event; return whether it may be believed."""
        if self.doubt or estimate.friction is None:
            self._found[False] += bool(_MISFITS & set(estimate.reasons))
            if not self.doubt and self._found[False] >= MOST_MISFITS and not self._found[True]:
                self.doubt = (
                    f"none of {self._found[False]} events fits: pressures, torque and speeds do not fit together "
                    "as the profile says"
                )
            return not self.doubt or estimate.status is not Status.VALID
        friction = estimate.friction
        new = self.new_mu_c[estimate.clutch - 1]
        ratio, spread = friction.mu_c / new, SURE_STD * friction.std_mu_c / new
        if ratio + spread < LEAST_RATIO or ratio - spread > MOST_RATIO:
            self.doubt = (
                f"friction would be {ratio:.0%} of what this type has new: torque, pressure or their scales are not "
                "what profile and calibration say"
            )
            return False
        self._found[True] += 1
        return True
