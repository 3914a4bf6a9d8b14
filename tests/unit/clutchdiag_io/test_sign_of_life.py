"""The file whose age tells that work gets done."""

from pathlib import Path

from clutchdiag_io.files import give_sign, make_sign


def test_a_new_sign_is_from_1970_until_something_is_done(tmp_path: Path) -> None:
    path = tmp_path / "alive"
    make_sign(path)
    assert path.stat().st_mtime == 0.0
    give_sign(path)
    assert path.stat().st_mtime > 0.0
