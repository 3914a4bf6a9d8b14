"""Numbers of binary logs."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.logs.text_kernels import half, lower, reversed_bytes, word


@settings(deadline=None)  # the first call compiles
@given(st.binary(min_size=8, max_size=8))
def test_numbers_are_little_endian(raw: bytes) -> None:
    column = np.frombuffer(b"x" + raw, np.uint8)
    assert half(column, 1) == int.from_bytes(raw[:2], "little")
    assert lower(column, 1) == int.from_bytes(raw[:4], "little")
    assert word(column, 1) == int.from_bytes(raw, "little")
    assert reversed_bytes(lower(column, 1)) == int.from_bytes(raw[:4], "big")
