"""Whole messages of any layout, classic and FD, multiplexed or not, decode to the bits of cantools."""

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.decode.codec import SignalBlock, message_table
from canlog.decode.signals import PayloadWords
from tests.support.cantools_oracle import reference, same_bits

FD_LENGTHS = [1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]
ROWS = 6
scales = st.one_of(st.sampled_from([1, 1.0, 2, -3, 0.25, 0.01, -0.1, 1e-7, 10**9]), st.floats(1e-6, 1e6))
offsets = st.one_of(st.sampled_from([0, -40, 273.15, -(10**6)]), st.floats(-1e6, 1e6))


@st.composite
def places(draw: st.DrawFn, bits: int) -> list[tuple[int, int]]:
    """Draw first bit and length of signals one behind the other, with gaps."""
    found: list[tuple[int, int]] = []
    first = draw(st.integers(0, min(bits - 1, 20)))
    while first < bits and len(found) < 12:
        length = draw(st.integers(1, min(64, bits - first)))
        found.append((first, length))
        first += length + draw(st.integers(0, 9))
    return found


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """Draw a message; all signals have one byte order, for else they would overlap."""
    size = draw(st.sampled_from(FD_LENGTHS))
    is_big = draw(st.booleans())
    spots = draw(places(8 * size))
    multiplexer = draw(st.integers(-1, len(spots) - 1)) if len(spots) > 1 else -1
    if multiplexer >= 0 and spots[multiplexer][1] > 5:
        multiplexer = -1
    signals = [
        _signal(
            draw, f"S{k}", first, length, is_big=is_big, page_of=_page_of(k, multiplexer, draw), is_mux=k == multiplexer
        )
        for k, (first, length) in enumerate(spots)
    ]
    return Message(0x100, "M", size, signals, strict=True, is_fd=size > 8)


def _page_of(number: int, multiplexer: int, draw: st.DrawFn) -> str | None:
    """Return the multiplexer of a signal; some are on no page."""
    return f"S{multiplexer}" if multiplexer >= 0 and number != multiplexer and draw(st.booleans()) else None


def _signal(
    draw: st.DrawFn, name: str, first: int, length: int, *, is_big: bool, page_of: str | None, is_mux: bool
) -> Signal:
    is_float = length in {16, 32, 64} and not is_mux and draw(st.booleans())
    conversion = BaseConversion.factory(
        scale=1 if is_mux else draw(scales), offset=0 if is_mux else draw(offsets), is_float=is_float
    )
    return Signal(
        name,
        start=8 * (first // 8) + 7 - first % 8 if is_big else first,
        length=length,
        byte_order="big_endian" if is_big else "little_endian",
        is_signed=not is_mux and draw(st.booleans()),
        conversion=conversion,
        is_multiplexer=is_mux,
        multiplexer_signal=page_of,
        multiplexer_ids=sorted(draw(st.sets(st.integers(0, 40), min_size=1, max_size=9))) if page_of else None,
    )


def random_payloads(seed: int, size: int) -> npt.NDArray[np.uint8]:
    """Return payload rows as wide as a batch would have them, zeros behind the message."""
    data = np.zeros((ROWS, 8 if size <= 8 else 64), np.uint8)
    data[:, :size] = np.random.default_rng(seed).integers(0, 256, (ROWS, size))
    return data


@settings(deadline=None)  # a busy machine is no failure
@given(messages(), st.integers(0, 2**32))
def test_any_message_decodes_to_the_bits_of_cantools(message: Message, seed: int) -> None:
    data = random_payloads(seed, message.length)
    table = message_table(message, check_range=False)
    assert not table.refused
    wanted = reference(message, [row[: message.length].tobytes() for row in data])
    words = PayloadWords(data)
    for name, decoded in SignalBlock(table.signals).decode(words).items():
        is_there = ~np.isnan(wanted[name])
        assert same_bits(decoded.value[is_there], wanted[name][is_there])
        good = np.ones(ROWS, np.bool_) if decoded.is_good is None else decoded.is_good
        assert np.array_equal(good, np.isfinite(wanted[name]))


@settings(deadline=None)  # a busy machine is no failure
@given(messages(), st.integers(0, 2**32))
def test_signals_decode_together_as_each_by_itself(message: Message, seed: int) -> None:
    data = random_payloads(seed, message.length)
    tables = message_table(message).signals
    rows = np.flatnonzero(np.random.default_rng(seed).random(ROWS) < 0.7)
    block = SignalBlock(tables)
    by_kernel, by_columns = (block.plain_values(PayloadWords(data, rows), by_kernel=way) for way in (True, False))
    assert all(
        np.array_equal(one.view(np.int64), other.view(np.int64))
        for one, other in zip(by_kernel, by_columns, strict=True)
    )
    together = block.decode(PayloadWords(data, rows))
    assert list(together) == list(tables)
    for name, table in tables.items():
        alone, found = table.decode(PayloadWords(data[rows])), together[name]
        assert same_bits(alone.value, found.value)
        assert alone.invalid.total == found.invalid.total
        assert (alone.is_good is None) == (found.is_good is None)
        if alone.is_good is not None and found.is_good is not None:
            assert np.array_equal(alone.is_good, found.is_good)
