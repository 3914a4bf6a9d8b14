"""Exponential and logarithm as plain arithmetic, against those of the C library."""

import math

import numpy as np
import pytest

from canlog.arrays import FloatArray
from canlog.jit import row_kernel
from clutch_model.pack import row_exponential, row_logarithm

LOGS = np.concatenate((np.linspace(-690.0, 690.0, 9973), np.linspace(-1.0, 1.0, 9973), [0.0, 1e-9, -1e-17]))


@row_kernel
def fill(exponents: FloatArray, values: FloatArray, powers: FloatArray, logs: FloatArray) -> None:
    for row in range(len(exponents)):
        powers[row], logs[row] = row_exponential(exponents[row]), row_logarithm(values[row])


def filled(exponents: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    powers, logs = np.empty_like(exponents), np.empty_like(values)
    fill(exponents, values, powers, logs)
    return powers, logs


def test_they_are_those_of_the_c_library() -> None:
    expected = np.array([math.exp(one) for one in LOGS.tolist()])
    powers, logs = filled(LOGS, expected)
    assert np.max(np.abs(powers / expected - 1.0)) < 1e-15
    expected_logs = np.array([math.log(one) for one in expected.tolist()])
    assert np.max(np.abs(logs - expected_logs) / np.maximum(np.abs(expected_logs), 1e-300)) < 1e-15


def test_numbers_next_to_one_have_their_logarithm() -> None:
    beside = np.array([1.0, 1.0 + 2.0**-52, 1.0 - 2.0**-53, math.sqrt(0.5), math.sqrt(2.0), 1e-307, 1e307])
    _, logs = filled(np.zeros_like(beside), beside)
    assert logs == pytest.approx([math.log(one) for one in beside.tolist()], rel=1e-15, abs=0.0)


def test_what_is_too_large_is_bounded_and_what_is_no_number_stays_none() -> None:
    powers, _ = filled(np.array([-1e9, 1e9, math.nan]), np.ones(3))
    assert powers[:2] == pytest.approx([math.exp(-700.0), math.exp(700.0)], rel=1e-12)
    assert np.isnan(powers[2])
