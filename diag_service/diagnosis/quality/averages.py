"""Mean and median of a few hundred numbers: what numpy's own return, which take longer to look what they were given."""

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel


def mean(values: FloatArray) -> float:
    """Return the mean of values, shape (n,), n >= 1."""
    return float(values.sum() / len(values))


@kernel
def median(values: FloatArray) -> float:
    """Return the median of finite values, shape (n,), n >= 1."""
    return float(np.median(values))


def compile_averages() -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    median(np.zeros(1))
