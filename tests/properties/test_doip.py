"""Streams and datagrams of any bytes: never a crash; what is answered does not depend on how a network cuts it."""

from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.doip.desk import ENTITY, Desk, activation, framed, messages_in, request
from workshop.controller.doip import datagram_reply

TYPES = st.sampled_from([0, 1, 2, 3, 4, 5, 6, 7, 8, 0x4001, 0x4003, 0x8001, 0x8002, 0x8003]) | st.integers(0, 0xFFFF)
MESSAGES = st.one_of(
    st.builds(
        activation, st.sampled_from([0x0E00, 0x0E01, 0x0001]), st.sampled_from([0, 1, 2]), st.sampled_from([2, 3])
    ),
    st.builds(request, st.binary(min_size=1, max_size=20), st.just(0x0E00), st.sampled_from([0x1011, 0xE400, 0x1012])),
    st.builds(framed, TYPES, st.binary(max_size=20), st.sampled_from([2, 3, 0xFF, 4])),
    st.binary(max_size=20),
)


def told(pieces: list[bytes]) -> tuple[list[tuple[int, bytes]], int, bool]:
    """Return what one connection is told, how many requests reached the controller, and whether it was closed."""
    desk = Desk()
    desk.open(1)
    answers = list(messages_in(bytes.fromhex(desk.put(1, *pieces))))
    return answers, len(desk.asked), bool(desk.closed)


@settings(max_examples=150)
@given(messages=st.lists(MESSAGES, max_size=8), cuts=st.lists(st.integers(0, 250), max_size=4))
def test_a_stream_is_answered_alike_however_it_is_cut(messages: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(messages)
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    answers, request_count, is_closed = told([stream])
    assert told([stream[start:stop] for start, stop in pairwise(places)]) == (answers, request_count, is_closed)
    taken = sum(kind == 0x8002 for kind, _ in answers)
    assert taken == request_count <= sum(message[2:4] == b"\x80\x01" for message in messages) + len(stream) // 13
    refused = [payload[:1] for kind, payload in answers if kind == 0x0000]
    assert is_closed or not {b"\x00", b"\x04"} & {*refused}  # ISO 13400-2: after these the connection ends


@settings(max_examples=150)
@given(data=MESSAGES)
def test_a_datagram_is_refused_if_its_header_is_none(data: bytes) -> None:
    reply = datagram_reply(ENTITY, b"WDCTEMUL3TED00047", 0, data)
    has_header = len(data) >= 8 and data[0] + data[1] == 255 and data[0] in {2, 3, 255}
    if not has_header:
        assert reply is not None
        assert next(iter(messages_in(reply.data))) == (0x0000, b"\x00")
    elif reply is not None:
        (kind, _), *others = messages_in(reply.data)
        assert kind in {0x0000, 0x0004, 0x4002, 0x4004}
        assert others == []
