"""A kernel is compiled again when a law that it calls is edited, in whichever file that stands."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from clutchdiag_io.program import KEPT_FOLDERS, PACKAGES, choose_kernel_cache

ROOT = Path(__file__).parents[3]
USE_LAWS = """
from clutchdiag_io.program import choose_kernel_cache
choose_kernel_cache()
from canlog.jit import on_compiling
compiled = []
on_compiling(compiled.append)
from ecu_emulator.caller import call
print(call(1.0), *compiled)
"""
CALLER = """
from canlog.jit import kernel
from clutch_model.law import law
@kernel
def call(value: float) -> float:
    return law(value)
"""
LAW = """
from canlog.jit import kernel
FACTOR = 2.0
@kernel
def law(value: float) -> float:
    return FACTOR * value
"""


def run(folder: Path, cache: Path) -> list[str]:
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", USE_LAWS], cwd=folder, env=environment, check=True, capture_output=True, text=True
    )
    return done.stdout.split()


def test_an_edited_law_of_another_file_is_compiled_and_an_unedited_one_is_not(tmp_path: Path) -> None:
    for package in ("canlog", "clutch_model", "ecu_emulator", "clutchdiag_io"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    for name in ("jit.py", "compiling.py"):
        shutil.copy(ROOT / "canlog" / "src" / "canlog" / name, tmp_path / "canlog")
    shutil.copy(ROOT / "clutchdiag_io" / "program.py", tmp_path / "clutchdiag_io")
    (tmp_path / "ecu_emulator" / "caller.py").write_text(CALLER)
    law, cache = tmp_path / "clutch_model" / "law.py", tmp_path / "cache"
    law.write_text(LAW)
    kernels = ["ecu_emulator.caller.call", "clutch_model.law.law"]
    assert run(tmp_path, cache) == ["2.0", *kernels]
    assert run(tmp_path, cache) == ["2.0"]
    law.write_text(LAW.replace("2.0", "3.0"))
    assert run(tmp_path, cache) == ["3.0", *kernels]


def test_a_few_versions_are_kept_and_nothing_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for age in range(10):
        (tmp_path / f"{age:064}").mkdir()
        os.utime(tmp_path / f"{age:064}", (1000 - age, 1000 - age))
    (tmp_path / "others").mkdir()
    choose_kernel_cache()
    chosen = Path(os.environ["NUMBA_CACHE_DIR"])
    assert chosen.parent == tmp_path
    newest = {f"{age:064}" for age in range(KEPT_FOLDERS - 1)}
    assert {path.name for path in tmp_path.iterdir()} == {"others", chosen.name} | newest
    choose_kernel_cache()  # a program that this one starts
    assert Path(os.environ["NUMBA_CACHE_DIR"]) == chosen


def test_a_home_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    choose_kernel_cache()


def test_all_modules_with_kernels_belong_to_the_state_of_the_sources() -> None:
    holders = [
        path.relative_to(ROOT).as_posix()
        for package in {name.partition("/")[0] for name in PACKAGES} | {"dbc", "clutchdiag_io", "fleet_backend"}
        for path in (ROOT / package).rglob("*.py")
        if re.search("^@kernel", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert holders
    assert [name for name in holders if not name.startswith(PACKAGES)] == []
