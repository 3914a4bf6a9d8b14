"""A study of hours that was ended goes on from its file."""

from pathlib import Path

import pytest

from benchmarks.study import over_drives


def root(case: int) -> list[float]:
    """Return what can be had of one case."""
    return [case**0.5]


def no_more(case: int) -> list[float]:
    """Refuse to work."""
    raise AssertionError(f"case {case} was worked on again")


def test_what_a_file_has_is_not_worked_on_again(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    assert over_drives(root, [4, 9], 1, kept) == [2.0, 3.0]
    assert over_drives(no_more, [9, 4], 1, kept) == [3.0, 2.0]
    with pytest.raises(AssertionError, match="case 16"):
        over_drives(no_more, [9, 16], 1, kept)
