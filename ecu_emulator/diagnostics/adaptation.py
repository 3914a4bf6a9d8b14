"""What a controller has adapted of its clutches: where each begins to carry torque."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from ecu_emulator.shift_control.touch_points import TouchPoint

CLUTCHES: Final = (1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Adaptation:
    """The touch points that were found, by clutch; without one a clutch is worked by that of its type."""

    touch_points: Mapping[int, TouchPoint] = field(default_factory=dict)
    awaits_estimate: bool = False  # what the estimate on board had learned was cleared with the touch points

    @property
    def is_done(self) -> bool:
        """Whether both clutches are adapted."""
        return set(self.touch_points) == set(CLUTCHES)

    def pressures_pa(self, nominal_pa: tuple[float, float]) -> tuple[float, float]:
        """Return by which touch points the clutches are worked [Pa]."""
        first, second = (
            point.pressure_pa if (point := self.touch_points.get(clutch)) is not None else nominal_pa[clutch - 1]
            for clutch in CLUTCHES
        )
        return first, second

    @property
    def stds_pa(self) -> dict[str, float]:
        """The deviations of what was found, as values of the controller by source [Pa]."""
        return {
            f"clutch{clutch}_touch_std_pa": point.std_pa
            for clutch, point in self.touch_points.items()
            if math.isfinite(point.std_pa)
        }
