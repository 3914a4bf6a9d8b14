"""A kernel computes what its source says."""

from typing import Any

import numpy as np
from numba.core import types

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, kernel, row_kernel, unchecked_kernel


def test_a_kernel_computes_what_its_source_says() -> None:
    @kernel
    def twice(value: float) -> float:
        return 2.0 * value

    assert twice(1.5) == 3.0


def test_a_kernel_without_reference_counts_computes_the_same() -> None:
    @array_kernel
    def twice(value: float) -> float:
        return 2.0 * value

    assert twice(1.5) == 3.0


def test_an_unchecked_kernel_rounds_each_product_and_divides_by_zero() -> None:
    @unchecked_kernel
    def beside_one(value: float) -> float:
        return value * value - 1.0

    @unchecked_kernel
    def reciprocal(value: float) -> float:
        return 1.0 / value

    assert beside_one(1.0 + 2.0**-30) == 2.0**-29  # joined with the sum the product would keep 2**-60
    assert reciprocal(0.0) == np.inf


def test_a_kernel_of_rows_computes_the_same_and_divides_by_zero() -> None:
    @row_kernel
    def divide(values: FloatArray, by: float) -> None:
        for row in range(len(values)):
            values[row] /= by

    values = np.array([1.0, -3.0])
    divide(values, 2.0)
    assert values.tolist() == [0.5, -1.5]
    divide(values, 0.0)
    assert values.tolist() == [np.inf, -np.inf]


def test_a_kernel_has_one_form_whatever_constants_others_call_it_with() -> None:
    @kernel
    def times(value: int, factor: int) -> int:
        return value * factor

    dispatcher: Any = times
    for factor in (types.IntegerLiteral(4), types.IntegerLiteral(64), types.int64):
        dispatcher.get_call_template((types.int64, factor), {})  # as a kernel that calls it does
    assert dispatcher.signatures == [(types.int64, types.int64)]
    assert times(3, 4) == 12
