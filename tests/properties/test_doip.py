"""Streams and datagrams of any bytes: never a crash, never a header unanswered that must be answered."""

from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.doip.desk import activation, framed, request
from tests.support.doip.streams import Figures, compare_datagram, compare_stream, run

TYPES = st.sampled_from([0, 1, 2, 3, 4, 5, 6, 7, 8, 0x4001, 0x4003, 0x8001, 0x8002, 0x8003]) | st.integers(0, 0xFFFF)
MESSAGES = st.one_of(
    st.builds(
        activation, st.sampled_from([0x0E00, 0x0E01, 0x0001]), st.sampled_from([0, 1, 2]), st.sampled_from([2, 3])
    ),
    st.builds(request, st.binary(min_size=1, max_size=20), st.just(0x0E00), st.sampled_from([0x1011, 0xE400, 0x1012])),
    st.builds(framed, TYPES, st.binary(max_size=20), st.sampled_from([2, 3, 0xFF, 4])),
    st.binary(max_size=20),
)


@settings(max_examples=150)
@given(messages=st.lists(MESSAGES, max_size=8), cuts=st.lists(st.integers(0, 250), max_size=4))
def test_a_stream_is_answered_as_the_book_says_however_it_is_cut(messages: list[bytes], cuts: list[int]) -> None:
    figures, stream = Figures(), b"".join(messages)
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    pieces = [stream[start:stop] for start, stop in pairwise(places)]
    compare_stream(stream, pieces, figures)
    assert figures.disagreements == []


@settings(max_examples=150)
@given(data=MESSAGES)
def test_a_datagram_is_answered_as_the_book_says(data: bytes) -> None:
    figures = Figures()
    compare_datagram(data, figures)
    assert figures.disagreements == []


def test_the_command_counts_and_finds_no_disagreement() -> None:
    figures = run(count=500, seed=3)
    assert (figures.streams, figures.datagrams, figures.disagreements) == (500, 5000, [])
    assert figures.requests > 500
    assert 100 < figures.closed < 450
