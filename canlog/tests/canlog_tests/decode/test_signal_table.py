"""Compiled signals decode to the same bits as cantools; what is no measurement is marked."""

import math

import cantools
import numpy as np
import numpy.typing as npt
import pytest
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from canlog.decode.signals import InvalidCounts, PayloadWords, compile_signal
from canlog.errors import DefinitionError
from tests.support.wire import CONTRACTS, DATABASE

UInt8Array = npt.NDArray[np.uint8]

payloads = hnp.arrays(np.uint8, st.tuples(st.integers(1, 12), st.just(8)))


def single(
    start: int, length: int, *, big: bool = False, scale: float = 1, offset: float = 0, **more: object
) -> Message:
    """Return a message with one signal; ``start`` counts bits in the order of transmission if big-endian."""
    conversion = BaseConversion.factory(
        scale=scale,
        offset=offset,
        is_float=bool(more.pop("is_float", False)),
        choices=more.pop("choices", None),  # type: ignore[arg-type]  # cantools wants its own mapping type
    )
    signal = Signal(
        "S",
        start=8 * (start // 8) + 7 - start % 8 if big else start,
        length=length,
        byte_order="big_endian" if big else "little_endian",
        conversion=conversion,
        **more,  # type: ignore[arg-type]  # whatever the test is about
    )
    return Message(0x100, "M", 8, [signal], strict=False)


def expected(message: Message, data: UInt8Array, name: str = "S") -> list[float]:
    """Return what cantools decodes, NaN where the signal is not in the frame."""
    rows = [message.decode(row.tobytes(), decode_choices=False) for row in data]
    values = []
    for row in rows:
        assert isinstance(row, dict)
        value = row.get(name, math.nan)
        assert isinstance(value, int | float)
        values.append(float(value))
    return values


def assert_same_bits(actual: npt.NDArray[np.float64], wanted: list[float]) -> None:
    reference = np.array(wanted)
    is_nan = np.isnan(reference)
    assert np.array_equal(np.isnan(actual), is_nan)
    assert np.array_equal(actual[~is_nan].view(np.uint64), reference[~is_nan].view(np.uint64))


@pytest.mark.parametrize("name", sorted(CONTRACTS))
@given(data=payloads)
def test_own_signals_are_good_inside_their_range_only(name: str, data: UInt8Array) -> None:
    message = DATABASE.get_message_by_name(name)
    words = PayloadWords(data)
    for signal in message.signals:
        decoded = compile_signal(message, signal).decode(words)
        assert signal.minimum is not None
        assert signal.maximum is not None
        step = signal.scale / 4
        in_range = [signal.minimum - step <= value <= signal.maximum + step for value in decoded.value.tolist()]
        good = np.ones(len(data), np.bool_) if decoded.is_good is None else decoded.is_good
        assert good.tolist() == in_range
        assert decoded.invalid.total == in_range.count(False)


@given(
    st.sampled_from([(63, 1), (64, 1), (60, 10**9), (64, -7), (54, 3)]),
    st.booleans(),
    st.sampled_from([0, 5, 0.5, -(10**30)]),
    payloads,
)
def test_integers_wider_than_a_float_keep_every_bit(
    shape: tuple[int, int], signed: bool, offset: float, data: UInt8Array
) -> None:
    length, scale = shape
    message = single(0, length, scale=scale, offset=offset, is_signed=signed)
    decoded = compile_signal(message, message.signals[0]).decode(PayloadWords(data))
    assert_same_bits(decoded.value, expected(message, data))


MULTIPLEXED = """VERSION ""
BU_: A
BO_ 256 M: 8 A
 SG_ Page M : 0|4@1+ (1,0) [0|15] "" A
 SG_ First m0 : 8|16@1- (0.5,0) [-10000|10000] "" A
 SG_ Second m1 : 8|16@1+ (1,-3) [0|0] "" A
 SG_ Inner m2M : 4|4@1+ (1,0) [0|15] "" A
 SG_ Deep m3 : 8|8@1+ (1,0) [0|0] "" A
 SG_ Always : 56|8@1+ (1,0) [0|0] "" A
SG_MUL_VAL_ 256 First Page 0-0, 5-7;
SG_MUL_VAL_ 256 Second Page 1-1;
SG_MUL_VAL_ 256 Inner Page 2-2;
SG_MUL_VAL_ 256 Deep Inner 3-3, 9-9;
"""


def multiplexed() -> Message:
    database = cantools.database.load_string(MULTIPLEXED, "dbc", strict=False)
    assert isinstance(database, Database)
    return database.messages[0]


@given(hnp.arrays(np.uint8, (6, 8)))
def test_multiplexed_signals_are_present_where_cantools_finds_them(data: UInt8Array) -> None:
    message = multiplexed()
    data[:, 0] = [0x00, 0x05, 0x07, 0x01, 0x32, 0x92]  # low nibble: page; high nibble: page within page 2
    for name in ("First", "Second", "Inner", "Deep", "Always"):
        decoded = compile_signal(message, message.get_signal_by_name(name), check_range=False).decode(
            PayloadWords(data)
        )
        wanted = np.array(expected(message, data, name))
        good = np.ones(len(data), np.bool_) if decoded.is_good is None else decoded.is_good
        assert good.tolist() == (~np.isnan(wanted)).tolist()
        assert decoded.value[good].tolist() == wanted[good].tolist()
        assert decoded.invalid.total == 0


def values(*bytes_0: int) -> UInt8Array:
    data = np.zeros((len(bytes_0), 8), np.uint8)
    data[:, 0] = bytes_0
    return data


def good(message: Message, data: UInt8Array, *, check_range: bool = True) -> list[bool]:
    decoded = compile_signal(message, message.signals[0], check_range=check_range).decode(PayloadWords(data))
    return [True] * len(data) if decoded.is_good is None else decoded.is_good.tolist()


def test_range_is_checked_to_the_nearest_step() -> None:
    message = single(0, 8, scale=0.1, offset=-1.0, minimum=0.0, maximum=15.3)
    assert good(message, values(9, 10, 163, 164)) == [False, True, True, False]
    assert good(message, values(9, 10, 163, 164), check_range=False) == [True] * 4


def test_codes_are_counted_apart_from_what_is_out_of_range() -> None:
    message = single(0, 8, minimum=0, maximum=100)
    for scale in (message, single(0, 8, minimum=0, maximum=100, scale=1.0)):
        table = compile_signal(scale, scale.signals[0], codes=((50, 60), (255, 255)))
        found = table.decode(PayloadWords(values(0, 50, 55, 61, 101, 255)))
        assert found.is_good is not None
        assert found.is_good.tolist() == [True, False, False, True, False, False]
        assert found.invalid == InvalidCounts(not_available=3, out_of_range=1)
        assert found.is_present is None  # all of them were sent


def test_floats_that_are_no_numbers_are_no_measurements() -> None:
    message = single(0, 32, is_float=True, minimum=-10.0, maximum=10.0)
    numbers = np.array([1.5, math.nan, math.inf, -math.inf, 10.0, 10.1], "<f4")
    data = np.zeros((6, 8), np.uint8)
    data[:, :4] = numbers.view(np.uint8).reshape(-1, 4)
    assert good(message, data) == [True, False, False, False, True, False]


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (single(60, 8), "outside its message"),
        (single(60, 8, big=True), "outside its message"),
        (single(0, 24, is_float=True), "no float has 24 bits"),
        (single(0, 8, scale=0), "not usable"),
        (single(0, 8, scale=math.inf), "not usable"),
        (single(0, 8, offset=math.nan), "not usable"),
        (single(0, 8, multiplexer_ids=[1], multiplexer_signal="Nobody"), "no proper multiplexer"),
        (single(0, 8, multiplexer_ids=[1]), "no proper multiplexer"),
    ],
)
def test_signals_that_cannot_be_decoded_are_refused(message: Message, complaint: str) -> None:
    with pytest.raises(DefinitionError, match=complaint):
        compile_signal(message, message.signals[0])
