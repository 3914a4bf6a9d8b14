"""The running friction of a clutch as it once was, and how much its error still has in common with today's."""

from dataclasses import dataclass, replace
from typing import Self

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.evidence import Knowledge
from diag_service.diagnosis.friction.parameters import PARAMETER_COUNT, friction_rows

BASELINE_SHIFT_COUNT = 15  # of the clutch: three times the shifts that settle a verdict
SHAPES = {"mean": (2,), "covariance": (2, 2), "cross": (PARAMETER_COUNT, 2)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """Frozen ``(mu_c, mu_s)`` of one clutch, times the gain of the torque reading.

    ``cross`` is the covariance between the error of what is known today and that of the baseline. It begins as the
    baseline's own and fades as later shifts outweigh the earlier ones.
    """

    mean: FloatArray  # (2,)
    covariance: FloatArray  # (2, 2)
    cross: FloatArray  # (PARAMETER_COUNT, 2)
    end_ns: int  # bus time of the last shift in it
    shift_count: int  # shifts in it
    later_count: int = 0  # shifts that became part of the base since

    @classmethod
    def of(cls, clutch: int, known: Knowledge, *, end_ns: int, count: int) -> Self:
        """Freeze the friction of a clutch."""
        rows = friction_rows(clutch)
        return cls(
            mean=known.mean[rows],
            covariance=known.covariance[rows, rows],
            cross=known.covariance[:, rows],
            end_ns=end_ns,
            shift_count=count,
        )

    def after(self, kept: FloatArray) -> Self:
        """Return the baseline after news of which this part of the earlier error is left."""
        return replace(self, cross=kept @ self.cross)
