"""The running friction of a clutch as it once was, and how much its error still has in common with today's."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.parameters import STATE_COUNT, Considered

BASELINE_SHIFT_COUNT = 15  # of the clutch: three times the shifts that settle a verdict
_ARRAYS = {
    "mean": (2,),
    "covariance": (2, 2),
    "sensitivity": (2, len(Considered)),
    "cross": (STATE_COUNT, 2),
}


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

    def to_json(self) -> dict[str, Any]:
        """Return the baseline as JSON-ready values; floats survive the round trip bit by bit."""
        arrays = {name: getattr(self, name).tolist() for name in _ARRAYS}
        return arrays | {"end_ns": self.end_ns, "shift_count": self.shift_count, "later_count": self.later_count}

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> Self:
        """Rebuild a baseline saved by `to_json`.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the table is not such a baseline.
        """
        arrays: dict[str, Any] = {name: np.array(table[name], dtype=np.float64) for name in _ARRAYS}
        for name, shape in _ARRAYS.items():
            if arrays[name].shape != shape or not np.all(np.isfinite(arrays[name])):
                raise ValueError(f"not a running state: bad {name} of a baseline")
        return cls(
            **arrays,
            end_ns=int(table["end_ns"]),
            shift_count=int(table["shift_count"]),
            later_count=int(table["later_count"]),
        )
