"""Which version is newer is decided by the versions alone, as people count."""

from hypothesis import given
from hypothesis import strategies as st

from fleet_backend.rows import version_rank

VERSION = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x24F), min_size=1, max_size=40)
NUMBER = st.integers(min_value=0, max_value=10**30)


@given(st.text("abc-.", max_size=8), NUMBER, NUMBER)
def test_numbers_count_as_numbers(name: str, one: int, other: int) -> None:
    ranks = [version_rank(f"{name}{number}", "1").encode() for number in (one, other)]
    assert (ranks[0] < ranks[1]) == (one < other)


@given(VERSION, VERSION, VERSION, VERSION)
def test_different_versions_have_different_ranks(a: str, b: str, c: str, d: str) -> None:
    assert (version_rank(a, b) == version_rank(c, d)) == ((a, b) == (c, d))


@given(NUMBER, NUMBER, NUMBER, NUMBER)
def test_the_algorithm_decides_before_the_calibration(a: int, b: int, c: int, d: int) -> None:
    newer = version_rank(f"alg-{a}", f"{b}+ffff") < version_rank(f"alg-{c}", f"{d}+0000")
    assert newer == ((a, b) < (c, d))
