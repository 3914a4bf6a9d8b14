"""The emulator's sign of life: a file that is as old as the last frame."""

import shutil
from pathlib import Path

import pytest

from ecu_emulator.errors import RecordError
from ecu_emulator.live.live_drive import SignOfLife


def test_the_file_is_touched_when_there_are_more_frames_than_before(tmp_path: Path) -> None:
    path = tmp_path / "alive"
    life = SignOfLife(path)
    life.tell(0)
    assert path.stat().st_mtime == 0.0
    life.tell(3)
    assert path.stat().st_mtime > 0.0


def test_a_sender_that_is_stuck_touches_nothing(tmp_path: Path) -> None:
    path = tmp_path / "alive"
    life = SignOfLife(path)
    life.tell(3)
    path.unlink()
    life.tell(3)
    assert not path.exists()


def test_a_file_that_cannot_be_made_is_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="cannot touch"):
        SignOfLife(tmp_path / "nowhere" / "alive")


def test_one_that_goes_away_later_does_not_end_the_drive(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    life = SignOfLife(folder / "alive")
    shutil.rmtree(folder)
    life.tell(7)
    assert not folder.exists()
