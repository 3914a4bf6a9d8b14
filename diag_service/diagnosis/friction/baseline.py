"""The running friction of a clutch as it once was, and how much its error still has in common with today's."""

from dataclasses import dataclass, replace
from typing import Self

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.parameters import STATE_COUNT, Considered

BASELINE_SHIFT_COUNT = 15  # of the clutch: three times the shifts that settle a verdict
SHAPES = {"mean": (2,), "covariance": (2, 2), "sensitivity": (2, len(Considered)), "cross": (STATE_COUNT, 2)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """Frozen ``(mu_c, mu_s)`` of one clutch, in the terms of `FilterState`.

    ``cross`` is the covariance between the random error of today's state and that of the baseline. It begins as the
    baseline's own and fades as later shifts outweigh the earlier ones.
    """

    mean: FloatArray  # (2,)
    covariance: FloatArray  # (2, 2), random part
    sensitivity: FloatArray  # (2, len(Considered))
    cross: FloatArray  # (len(State), 2)
    end_ns: int  # bus time at which it was frozen
    shift_count: int  # shifts in it
    later_count: int = 0  # shifts used since

    @classmethod
    def of(
        cls, rows: slice, mean: FloatArray, covariance: FloatArray, sensitivity: FloatArray, *, end_ns: int, count: int
    ) -> Self:
        """Freeze some rows of a running state."""
        return cls(
            mean=mean[rows],
            covariance=covariance[rows, rows],
            sensitivity=sensitivity[rows],
            cross=covariance[:, rows],
            end_ns=end_ns,
            shift_count=count,
        )

    def after(self, keep: FloatArray) -> Self:
        """Return the baseline after an update of the state that keeps this part of the earlier error."""
        return replace(self, cross=keep @ self.cross)

    def without(self, rows: slice) -> Self:
        """Return the baseline after some rows of the state were forgotten: nothing new has to do with it."""
        cross = self.cross.copy()
        cross[rows] = 0.0
        return replace(self, cross=cross)
