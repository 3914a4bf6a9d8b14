"""Databases that were parsed are not parsed again, unless they, the parser or the trust in what is kept changed."""

import os
import subprocess
from pathlib import Path
from unittest.mock import Mock

import pytest

from canlog.database.loading import MOST_KEPT, keep, kept, key_of, load_database

DATABASE = """VERSION ""
BU_: A
BO_ 256 Brake: 8 A
 SG_ Speed : 0|8@1+ (1,0) [0|0] "km/h" A
"""


@pytest.fixture(name="folder")
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty cache, which is the user's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "clutchdiag" / "databases"


def test_a_database_is_parsed_once(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    children = Mock(wraps=subprocess.run)
    monkeypatch.setattr("canlog.database.loading.subprocess.run", children)
    (tmp_path / "car.dbc").write_text(DATABASE, encoding="ascii")
    parsed = [load_database(tmp_path / "car.dbc").messages[0].signals[0] for _ in range(2)]
    assert (children.call_count, parsed[0].unit, parsed[1].unit) == (1, "km/h", "km/h")
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:-1] + b"!")  # damaged
    load_database(tmp_path / "car.dbc")
    assert children.call_count == 2
    (tmp_path / "car.dbc").write_text(DATABASE.replace("km/h", "mph"), encoding="ascii")
    assert load_database(tmp_path / "car.dbc").messages[0].signals[0].unit == "mph"
    assert children.call_count == 3


def test_what_somebody_else_could_write_is_not_believed(folder: Path, tmp_path: Path) -> None:
    key = key_of(DATABASE, "dbc", "strict")
    assert key != key_of(DATABASE, "dbc", "lenient")
    keep(key, b"parsed")
    assert kept(key) == b"parsed"
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o770)
    assert kept(key) is None
    keep(key, b"other")
    folder.chmod(0o700)
    assert kept(key) == b"parsed"
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    assert kept(key) is None


def test_the_oldest_are_forgotten(folder: Path) -> None:
    for number in range(MOST_KEPT + 1):
        keep(f"{number}", b"parsed")
        os.utime(folder / f"{number}", (number, number)) if number < MOST_KEPT else None
    assert {path.name for path in folder.iterdir()} == {f"{number}" for number in range(1, MOST_KEPT + 1)}
