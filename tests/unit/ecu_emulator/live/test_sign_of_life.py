"""The emulator's sign of life: a file that is as old as the last frame."""

from pathlib import Path

from ecu_emulator.live.live_drive import SignOfLife


def test_the_file_is_touched_when_there_are_more_frames_than_before(tmp_path: Path) -> None:
    path = tmp_path / "alive"
    life = SignOfLife(path)
    life.tell(0)
    assert path.stat().st_mtime == 0.0
    life.tell(3)
    assert path.stat().st_mtime > 0.0
