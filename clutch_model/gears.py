"""Which clutch carries a gear: the one thing that plant, control and diagnosis all know of the gearbox's layout."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Gear = TypeVar("Gear", int, npt.NDArray[np.int64], npt.NDArray[np.float64])


def clutch_of_gear(gear: Gear) -> Gear:
    """Return the clutch that carries a gear: 1 the odd ones, 2 the even ones; a number, or an array of them.

    Neutral (0) counts as even: something has to be said of it, and nothing that matters depends on it.
    """
    return 1 + (gear - 1) % 2
