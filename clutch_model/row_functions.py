"""The exponential and the logarithm as plain arithmetic: a loop over rows that calls them does several rows at once.

Those of the C library are called for one number after the other. Where one number waits for the one before, they are
the faster ones. Bits are those of IEEE 754: 52 of a fraction behind 11 of an exponent, which begins at 1023.
"""

import math
from typing import Final

import numpy as np

from canlog.jit import unchecked_kernel

_FRACTION_BITS: Final = np.int64(52)
_EXPONENT_START: Final = np.int64(1023)
_ROUNDER: Final = 1.5 * 2.0**52  # a sum with it has no digits behind the point, and its last bits are the whole number
_MOST: Final = 700.0  # of an exponent: its power has a number
_PER_LOG_2: Final = 1.0 / math.log(2.0)
_LOG_2: Final = float.fromhex("0x1.62e42fefap-1")  # its products with whole numbers are exact
_LOG_2_REST: Final = float.fromhex("0x1.cf79abc9e3b3ap-40")
_ROOT_HALF_BITS: Final = np.float64(math.sqrt(0.5)).view(np.int64)
_E: Final = tuple(1.0 / math.factorial(n) for n in range(14))  # Taylor's series, right to 2e-16 up to half of log(2)
_L: Final = tuple(1.0 / n for n in range(3, 25, 2))  # of the area tangent, right to 1e-17 up to 0.172


@unchecked_kernel
def row_exponential(exponent: float) -> float:
    """Return e to a power, which counts as -700 or 700 beyond; right to 1e-15."""
    bounded = min(max(exponent, -_MOST), _MOST)
    rounded = bounded * _PER_LOG_2 + _ROUNDER
    twos = rounded - _ROUNDER
    x = (bounded - twos * _LOG_2) - twos * _LOG_2_REST
    x2 = x * x
    first = (_E[0] + x * _E[1]) + x2 * (_E[2] + x * _E[3])
    second = (_E[4] + x * _E[5]) + x2 * (_E[6] + x * _E[7])
    third = (_E[8] + x * _E[9]) + x2 * (_E[10] + x * _E[11])
    series = first + x2 * x2 * (second + x2 * x2 * (third + x2 * x2 * (_E[12] + x * _E[13])))
    power_bits = (np.float64(rounded).view(np.int64) + _EXPONENT_START) << _FRACTION_BITS
    return series * np.int64(power_bits).view(np.float64)


@unchecked_kernel
def row_logarithm(value: float) -> float:
    """Return the natural logarithm of a positive number that is not below 1e-307; right to 1e-15."""
    bits = np.float64(value).view(np.int64)
    twos = (bits - _ROOT_HALF_BITS) >> _FRACTION_BITS
    near_one = np.int64(bits - (twos << _FRACTION_BITS)).view(np.float64)
    x = (near_one - 1.0) / (near_one + 1.0)
    x2 = x * x
    x4 = x2 * x2
    first = (_L[0] + x2 * _L[1]) + x4 * (_L[2] + x2 * _L[3])
    second = (_L[4] + x2 * _L[5]) + x4 * (_L[6] + x2 * _L[7])
    third = (_L[8] + x2 * _L[9]) + x4 * _L[10]
    series = first + x4 * x4 * (second + x4 * x4 * third)
    return twos * _LOG_2 + (2.0 * x + (2.0 * x * x2 * series + twos * _LOG_2_REST))
