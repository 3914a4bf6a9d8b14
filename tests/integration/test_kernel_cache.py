"""Machine code is compiled once per machine: not again for an edited comment, another checkout or another folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import canlog
import clutch_model

PACKAGES = [Path(package.__file__ or "").parent for package in (clutch_model, canlog)]
LAWS, LIBRARY = (package.name for package in PACKAGES)
USE_LAWS = """
from canlog.jit import on_compiling
compiled = []
on_compiling(compiled.append)
from clutch_model.pack import FrictionLaw, kinetic_friction
mu = kinetic_friction(10.0, FrictionLaw(0.1, 0.12, 5.0, 1.0, 0.1))
print(*(name.rpartition(".")[2] for name in compiled))
"""
COLD = {"kinetic_friction", "stribeck_weights"}


class Checkout:
    """A copy of the laws in a folder of its own, all copies with one cache."""

    def __init__(self, folder: Path, cache: Path) -> None:
        self._folder, self._cache = folder, cache
        for package in PACKAGES:
            shutil.copytree(package, folder / package.name, ignore=shutil.ignore_patterns("__pycache__"))

    def edit(self, name: str, old: str, new: str) -> None:
        path = self._folder / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    def comment_everywhere(self) -> None:
        for path in (self._folder / LAWS).glob("*.py"):
            head, _, rest = path.read_text().partition("\n\n")
            path.write_text(f"{head}\n\n# edited\n{rest}\n# edited\n")

    def move(self, name: str, new_name: str) -> None:
        """Give a module of the laws another name, wherever it is mentioned."""
        laws = self._folder / LAWS
        (laws / f"{name}.py").rename(laws / f"{new_name}.py")
        for path in laws.glob("*.py"):
            path.write_text(path.read_text().replace(f"{LAWS}.{name} ", f"{LAWS}.{new_name} "))

    def compiled(self, law: str = "pack") -> set[str]:
        """Return the names of the kernels that a program compiles here."""
        done = subprocess.run(
            [sys.executable, "-c", USE_LAWS.replace("pack import", f"{law} import")],
            cwd=self._folder,
            env={**os.environ, "PYTHONPATH": str(self._folder), "XDG_CACHE_HOME": str(self._cache)},
            capture_output=True,
            text=True,
            check=True,
        )
        return set(done.stdout.split())


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a cache that a first checkout has filled."""
    cache = tmp_path_factory.mktemp("filled") / "cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("NUMBA_CACHE_DIR", raising=False)
        assert Checkout(cache.with_name("first"), cache).compiled() == COLD
    return cache


@pytest.fixture
def cache(filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    return shutil.copytree(filled, tmp_path / "cache")


def test_a_comment_and_another_folder_compile_nothing_and_a_law_what_it_is_part_of(tmp_path: Path, cache: Path) -> None:
    first = Checkout(tmp_path / "first", cache)
    second = Checkout(tmp_path / "second", cache)
    second.comment_everywhere()
    assert second.compiled() == set()
    second.edit("clutch_model/pack.py", "np.exp(-excess)", "np.exp(-2.0 * excess)")
    assert second.compiled() == COLD
    assert first.compiled() == set()  # whose machine code is still there


def test_machine_code_that_cannot_be_loaded_is_made_anew(tmp_path: Path, cache: Path) -> None:
    checkout = Checkout(tmp_path / "only", cache)
    for index in cache.rglob("*.nbi"):
        index.write_bytes(index.read_bytes()[:-20])
    assert checkout.compiled() == COLD
    assert checkout.compiled() == set()
