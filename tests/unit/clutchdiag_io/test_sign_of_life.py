"""The file whose age tells that work gets done."""

from pathlib import Path

import pytest

from clutchdiag_io.files import give_sign, make_sign


def test_a_new_sign_is_from_1970_until_something_is_done(tmp_path: Path) -> None:
    path = tmp_path / "alive"
    make_sign(path)
    assert path.stat().st_mtime == 0.0
    give_sign(path)
    assert path.stat().st_mtime > 0.0


def test_a_sign_of_an_earlier_run_counts_for_nothing(tmp_path: Path) -> None:
    path = tmp_path / "alive"
    path.touch()
    make_sign(path)
    assert path.stat().st_mtime == 0.0


def test_one_that_cannot_be_made_is_the_callers_to_say(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        make_sign(tmp_path / "nowhere" / "alive")


def test_one_that_cannot_be_touched_any_more_ends_nothing(tmp_path: Path) -> None:
    give_sign(tmp_path / "nowhere" / "alive")
