"""Which clutch carries a gear, the one thing that all know of the gearbox's layout; and what both clutches have."""

from collections.abc import Iterable
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from canlog.jit import kernel

Gear = TypeVar("Gear", int, npt.NDArray[np.int64], npt.NDArray[np.float64])
T = TypeVar("T")


def clutch_of_gear(gear: Gear) -> Gear:
    """Return the clutch that carries a gear: 1 the odd ones, 2 the even ones; a number, or an array of them.

    Neutral (0) counts as even: something has to be said of it, and nothing that matters depends on it.
    """
    return 1 + (gear - 1) % 2


gear_clutch = kernel(clutch_of_gear)  # the same, for other kernels


def both_clutches(values: Iterable[T]) -> tuple[T, T]:
    """Return what clutch 1 and what clutch 2 has; raises ValueError unless there are two."""
    first, second = values
    return first, second


def with_clutch(both: tuple[T, T], clutch: int, value: T) -> tuple[T, T]:
    """Return what both clutches have, with another value for clutch 1 or 2."""
    return (value, both[1]) if clutch == 1 else (both[0], value)
