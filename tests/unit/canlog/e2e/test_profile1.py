"""End-to-end protection against an independent implementation of AUTOSAR E2E profile 1."""

import e2e.p01
import numpy as np
import numpy.typing as npt
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from canlog.e2e.profile1 import COUNTER_PERIOD, counter_of, crc_is_valid, data_id_remainder, protect

UInt8Array = npt.NDArray[np.uint8]

payloads = hnp.arrays(np.uint8, st.tuples(st.integers(1, 20), st.just(8)))
data_ids = st.integers(0, 0xFFFF)


def oracle(payload: UInt8Array, data_id: int) -> bytes:
    """Return the payload as the independent implementation protects it, its counter kept."""
    buffer = bytearray(payload.tobytes())
    e2e.p01.e2e_p01_protect(buffer, data_id, increment_counter=False)
    return bytes(buffer)


@given(payloads, data_ids, st.integers(0, 1000))
def test_protect_agrees_with_the_oracle(data: UInt8Array, data_id: int, first: int) -> None:
    counter = first + np.arange(len(data))
    protected = protect(data, data_id, counter)
    assert counter_of(protected).tolist() == (counter % COUNTER_PERIOD).tolist()
    assert [row.tobytes() for row in protected] == [oracle(row, data_id) for row in protected]


@given(payloads, data_ids, st.booleans())
def test_check_agrees_with_the_oracle(data: UInt8Array, data_id: int, is_protected: bool) -> None:
    """The oracle's check is CRC and a counter that is one: 15 is not."""
    if is_protected:
        data[:, 0] = [oracle(row, data_id)[0] for row in data]
    expected = [bool(e2e.p01.e2e_p01_check(bytearray(row.tobytes()), data_id)) for row in data]
    is_counter = counter_of(data) < COUNTER_PERIOD
    assert (crc_is_valid(data, data_id_remainder(data_id)) & is_counter).tolist() == expected
    assert crc_is_valid(data, data_id_remainder(data_id)).all() or not is_protected


@given(hnp.arrays(np.uint8, (1, 8)), data_ids)
def test_every_single_bit_flip_is_caught(data: UInt8Array, data_id: int) -> None:
    protected = protect(data, data_id, np.array([7]))
    flips = np.packbits(np.eye(64, dtype=np.uint8), axis=1)
    remainder = data_id_remainder(data_id)
    assert crc_is_valid(protected, remainder).all()
    assert not crc_is_valid(protected ^ flips, remainder).any()
