"""Machine code belongs to the sources it was made of."""

import shutil
from pathlib import Path

import clutch_model
from clutch_model.jit import cache_folder, kernel

PACKAGE = Path(clutch_model.__file__).parent


def test_a_kernel_computes_what_its_source_says() -> None:
    @kernel
    def twice(value: float) -> float:
        return 2.0 * value

    assert twice(1.5) == 3.0


def test_an_edited_source_gets_a_folder_of_its_own(tmp_path: Path) -> None:
    package = tmp_path / "laws"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    before = cache_folder(package, str(tmp_path / "cache"))
    (package / "film.py").write_text((package / "film.py").read_text() + "\n# edited\n")
    cache_folder.cache_clear()
    after = cache_folder(package, str(tmp_path / "cache"))
    assert before != after
    assert Path(before).is_dir()
    assert Path(after).is_dir()


def test_where_no_folder_can_be_made_numba_decides(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert cache_folder(PACKAGE, str(blocked)) == ""
