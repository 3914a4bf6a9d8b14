"""Sound zlib streams are inflated, by whatever library; anything else is left alone."""

import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.logs.blf import Inflate, adler32, inflated_by_libdeflate, inflated_by_zlib, sound_contents

CONTENTS = bytes(range(256)) * 40 + b"container" * 300
STREAM = zlib.compress(CONTENTS)
PADDING = 8


def both() -> list[Inflate]:
    """Return what inflates on this machine."""
    return [inflated_by_zlib, *([inflated_by_libdeflate] if inflated_by_libdeflate else [])]


@pytest.mark.parametrize("inflate", both())
@pytest.mark.parametrize("padding", range(PADDING + 1))
def test_a_sound_stream_is_inflated(inflate: Inflate, padding: int) -> None:
    for fill in (b"\0", b"\xff"):
        assert inflate(memoryview(STREAM + fill * padding), len(CONTENTS), PADDING) == CONTENTS


@pytest.mark.parametrize("inflate", both())
@pytest.mark.parametrize(
    "stream",
    [
        b"",
        b"\x78",
        STREAM[:-1],
        STREAM[:-4],
        STREAM + bytes(PADDING + 1),
        STREAM + zlib.compress(CONTENTS[1:]),
        STREAM[:-1] + bytes([STREAM[-1] ^ 1]),
        STREAM[:100] + bytes([STREAM[100] ^ 1]) + STREAM[101:],
        b"\x79" + STREAM[1:],
        b"\x78\xbb" + STREAM[2:],
        b"\x00\x00" + STREAM[2:],
    ],
)
def test_anything_else_is_not(inflate: Inflate, stream: bytes) -> None:
    assert inflate(memoryview(stream), len(CONTENTS), PADDING) is None


@pytest.mark.parametrize("inflate", both())
@pytest.mark.parametrize("stated_bytes", [0, 1, len(CONTENTS) - 1])
def test_nor_is_what_inflates_to_more_than_is_said(inflate: Inflate, stated_bytes: int) -> None:
    assert inflate(memoryview(STREAM), stated_bytes, PADDING) is None


@pytest.mark.parametrize("inflate", both())
def test_a_stated_size_that_no_stream_can_have_takes_no_memory(inflate: Inflate) -> None:
    assert inflate(memoryview(STREAM), len(CONTENTS) + 100, PADDING) == CONTENTS
    assert inflate(memoryview(STREAM[:50]), 2**62, PADDING) is None


@pytest.mark.parametrize("inflate", both())
def test_a_stream_that_could_inflate_to_too_much_is_left_alone(inflate: Inflate) -> None:
    large = zlib.compress(bytes(300_000_000), level=1)
    assert inflate(memoryview(large), 300_000_000, PADDING) is None


def test_the_faster_one_is_used() -> None:
    assert sound_contents is (inflated_by_libdeflate or inflated_by_zlib)


@settings(deadline=None)  # the first call compiles
@given(st.binary(max_size=2_000), st.integers(1, 12))
def test_the_checksum_is_that_of_zlib(data: bytes, times: int) -> None:
    assert adler32(np.frombuffer(data * times, np.uint8)) == zlib.adler32(data * times)


@pytest.mark.parametrize("fill", [0, 255])
def test_the_checksum_does_not_overflow(fill: int) -> None:
    data = bytes([fill]) * 1_000_000
    assert adler32(np.frombuffer(data, np.uint8)) == zlib.adler32(data)
