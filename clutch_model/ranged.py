"""Records whose numbers are checked once, when they are made."""

import math
from dataclasses import dataclass

from clutch_model.errors import CalibrationError

Pair = tuple[float, float]  # clutch 1 first


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranged:
    """A record whose every number is finite and, unless a subclass says otherwise, not negative."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if type(value) is float and 0.0 <= value < math.inf:  # as nearly all are
                continue
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, int | float) and not (math.isfinite(number) and number >= 0.0):
                    raise CalibrationError(f"{name} must be finite and >= 0, got {number}")
