"""What is known of a lining over the fluids that it had: friction with the first fluid, beside that of today's."""

from dataclasses import dataclass
from math import hypot
from typing import Self

from diag_service.diagnosis.records import FrictionTrend, LiningChange, ScaleFreeFriction


@dataclass(frozen=True, slots=True, kw_only=True)
class LiningBaseline:
    """Scale-free friction of one clutch at the baseline of its first fluid; the deviations have no common scale."""

    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    shift_count: int

    @classmethod
    def of(cls, free: ScaleFreeFriction, since: FrictionTrend) -> Self:
        """Return the baseline from the friction at the end of the first fluid, and its change until then."""
        ratio_c, ratio_s = 1.0 + since.change_mu_c_ratio, 1.0 + since.change_mu_s_ratio
        return cls(
            mu_c=free.mu_c / ratio_c,
            mu_s=free.mu_s / ratio_s,
            std_mu_c=free.std_mu_c / ratio_c,
            std_mu_s=free.std_mu_s / ratio_s,
            shift_count=since.baseline_shift_count,
        )

    @property
    def is_possible(self) -> bool:
        """Whether a store can have kept such numbers."""
        return min(self.mu_c, self.mu_s) > 0.0 and min(self.std_mu_c, self.std_mu_s) >= 0.0

    def change(self, free: ScaleFreeFriction) -> LiningChange:
        """Return how friction with today's fluid differs.

        The errors of both count as independent: those that they share make the stated deviation too large, not too
        small.
        """
        return LiningChange(
            change_mu_c_ratio=free.mu_c / self.mu_c - 1.0,
            change_mu_s_ratio=free.mu_s / self.mu_s - 1.0,
            std_change_mu_c_ratio=hypot(free.std_mu_c, free.mu_c / self.mu_c * self.std_mu_c) / self.mu_c,
            std_change_mu_s_ratio=hypot(free.std_mu_s, free.mu_s / self.mu_s * self.std_mu_s) / self.mu_s,
            baseline_shift_count=self.shift_count,
        )
