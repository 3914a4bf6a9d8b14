"""A study of hours that was ended goes on from its file."""

from pathlib import Path

import pytest

from benchmarks.drawn_vehicle import Vehicle, draw
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


def test_a_record_that_was_being_written_at_the_end_is_made_again(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    over_drives(root, [4, 9], 1, kept)
    kept.write_bytes(kept.read_bytes()[:-5])
    assert over_drives(root, [4, 9, 16], 1, kept) == [2.0, 3.0, 4.0]
    assert over_drives(no_more, [4, 9, 16], 1, kept) == [2.0, 3.0, 4.0]


def seed_of(vehicle: Vehicle) -> list[int]:
    """Return what tells a vehicle from others."""
    return [vehicle.seed]


def test_a_drawn_vehicle_is_a_case() -> None:
    assert over_drives(seed_of, [draw(seed, has_mismatch=True) for seed in (5, 3)], 1) == [5, 3]
