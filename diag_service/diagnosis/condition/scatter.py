"""Shift-to-shift scatter: how far single shifts of a clutch lie from the running estimate, measured, not stated."""

from dataclasses import dataclass
from typing import Self

from diag_service.diagnosis.records import FrictionEstimate, ShiftScatter

LEAST_SHIFT_COUNT = 8  # the deviation is then known to a quarter of itself
MEMORY_SHIFT_COUNT = 50  # a few hours of driving
STATED_WEIGHT = 4.0  # shifts that the stated deviation of the first counts for: something to clip against
CLIP_STD = 3.0  # a shift farther away counts as if it were so far; takes 0.5 % from the variance of normal ones


@dataclass(frozen=True, slots=True, kw_only=True)
class Scatter:
    """Running variances of single shifts about the running estimate, recursive and with outliers clipped."""

    variance_mu_c: float
    variance_mu_s: float
    shift_count: int

    @classmethod
    def begun(cls, alone: FrictionEstimate) -> Self:
        """Return the scatter to expect before any was seen: the random deviation that a shift states."""
        return cls(variance_mu_c=alone.random_std_mu_c**2, variance_mu_s=alone.random_std_mu_s**2, shift_count=0)

    def with_shift(self, alone: FrictionEstimate, running: FrictionEstimate) -> Self:
        """Return the scatter after another shift.

        Parameters
        ----------
        alone : FrictionEstimate
            Of the shift for itself.
        running : FrictionEstimate
            Of the clutch before the shift; its own random deviation is taken out.
        """
        count = self.shift_count + 1
        weight = 1.0 / (STATED_WEIGHT + min(count, MEMORY_SHIFT_COUNT))
        return type(self)(
            variance_mu_c=_next_variance(
                self.variance_mu_c, alone.mu_c - running.mu_c, alone.random_std_mu_c, running.random_std_mu_c, weight
            ),
            variance_mu_s=_next_variance(
                self.variance_mu_s, alone.mu_s - running.mu_s, alone.random_std_mu_s, running.random_std_mu_s, weight
            ),
            shift_count=count,
        )

    @property
    def is_possible(self) -> bool:
        """Whether shifts can scatter so; what was stored may be damaged."""
        return 0.0 < self.variance_mu_c < 1.0 and 0.0 < self.variance_mu_s < 1.0 and self.shift_count >= 0

    @property
    def reported(self) -> ShiftScatter | None:
        """What a result says of it; None before there were enough shifts."""
        if self.shift_count < LEAST_SHIFT_COUNT:
            return None
        return ShiftScatter(
            std_mu_c=self.variance_mu_c**0.5, std_mu_s=self.variance_mu_s**0.5, shift_count=self.shift_count
        )


def _next_variance(variance: float, distance: float, alone_std: float, running_std: float, weight: float) -> float:
    share = alone_std**2 / (alone_std**2 + running_std**2)
    return variance + weight * (min(share * distance**2, CLIP_STD**2 * variance) - variance)
