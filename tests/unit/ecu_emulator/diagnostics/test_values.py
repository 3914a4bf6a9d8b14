"""Values as bytes and back: floats, which no table had before the workshop routine."""

import math
import struct

import pytest

from ecu_emulator.diagnostics.descriptions import Coding, Field
from ecu_emulator.diagnostics.values import decoded, encode

WIDE = Field(name="wide", kind=Coding.FLOAT, size_bytes=8, source="mu")
NARROW = Field(name="narrow", kind=Coding.FLOAT, size_bytes=4, source="pressure_pa", unit="bar")


@pytest.mark.parametrize("value", [0.1 + 0.2, -1e-300, 0.0, 5e-324])
def test_a_float_comes_back_to_the_bit(value: float) -> None:
    assert decoded((WIDE,), encode((WIDE,), {"mu": value})) == {"mu": value}


def test_a_float_is_in_its_unit() -> None:
    data = encode((NARROW,), {"pressure_pa": 2.5e5})
    assert struct.unpack(">f", data) == (2.5,)
    assert decoded((NARROW,), data) == {"pressure_pa": 2.5e5}


def test_what_is_not_known_is_not_a_number() -> None:
    data = encode((WIDE, NARROW), {"pressure_pa": math.nan})
    assert [math.isnan(number) for number in struct.unpack(">df", data)] == [True, True]
    assert decoded((WIDE, NARROW), data) == {}
