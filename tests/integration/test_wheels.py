"""The wheels that ``make wheels`` builds: each holds its own packages, and works where nothing of the others is."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.support.distributions import FOLDERS, PACKAGES, ROOT, SOURCES, pyproject, requirements
from tests.support.plain_install import PlainInstall, distributions_of, linked_environment

BELOW = {
    "canlog": (),
    "can-silkit": (),
    "clutchdiag": ("canlog",),
    "clutchdiag-workshop": ("clutchdiag", "canlog"),
    "clutchdiag-fleet": ("clutchdiag", "canlog"),
}
LOAD_ALL = """
import importlib, pkgutil, sys
for name in sys.argv[1:]:
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, f"{name}."):
        if module.name.rpartition(".")[2] not in ("__main__", "env", "pytest_plugin"):
            importlib.import_module(module.name)
    print(package.__file__)
"""
EXTRAS = {
    "clutchdiag-workshop": ("diagnostics", "uds", "odx"),
    "clutchdiag-fleet": ("nats", "page"),
    "clutchdiag": ("cluster", "test"),
}


def pip(*words: str | Path) -> None:
    """Have pip fetch nothing, and mind no version of Python: can-silkit says on 3.11, too, what it needs."""
    command = [sys.executable, "-m", "pip", *words, "-q", "--no-deps", "--no-index", "--ignore-requires-python"]
    environment = {**os.environ, "CLUTCHDIAG_RELEASE": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(name="wheels", scope="module")
def _wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Build all from copies, as a release does: building leaves files beside the sources."""
    folder = tmp_path_factory.mktemp("wheels")
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file() and not name.startswith(("tests/", "benchmarks/", "docs/")):
            (folder / "sources" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / "sources" / name)
    places = [folder / "sources" / place.relative_to(ROOT) for place in FOLDERS.values()]
    pip("wheel", "--no-build-isolation", "-w", folder, *places)
    return {name: next(folder.glob(f"{name.replace('-', '_')}-*.whl")) for name in FOLDERS}


@pytest.mark.parametrize("name", FOLDERS)
def test_a_wheel_holds_its_own_packages_and_names_the_others_by_version(wheels: dict[str, Path], name: str) -> None:
    with ZipFile(wheels[name]) as wheel:
        held = {place for place in wheel.namelist() if ".dist-info/" not in place}
        (place,) = (place for place in wheel.namelist() if place.endswith("/METADATA"))
        metadata = wheel.read(place).decode()
    own = [folder for folder in PACKAGES.values() if folder.parent == SOURCES[name]]
    modules = {path.relative_to(SOURCES[name]).as_posix() for folder in own for path in folder.rglob("*.py")}
    assert {place for place in held if place.endswith(".py")} == modules
    assert {place for place in held if place.endswith("py.typed")} == {f"{folder.name}/py.typed" for folder in own}
    assert "file:" not in metadata
    assert [one for one in BELOW[name][:1] if f"Requires-Dist: {one}>=0.9" not in metadata] == []


@pytest.mark.parametrize("name", FOLDERS)
def test_a_wheel_works_with_what_it_requires_and_nothing_else(
    wheels: dict[str, Path], tmp_path: Path, name: str
) -> None:
    needed = [name, *BELOW[name]]
    linked_environment(tmp_path / "env", distributions_of(requirements(name, *EXTRAS.get(name, ()))))
    python = tmp_path / "env" / "bin" / "python"
    pip("--python", python, "install", *(wheels[one] for one in needed))
    alone = PlainInstall(python=python)
    packages = [folder.name for folder in PACKAGES.values() if folder.parent == SOURCES[name]]
    told = alone.run("-c", LOAD_ALL, *packages, cwd=tmp_path)
    assert told.status == 0, told.err
    assert [place for place in told.out.splitlines() if not Path(place).is_relative_to(tmp_path)] == []
    for program in pyproject(name)["project"].get("scripts", {}):
        shown = subprocess.run([python.with_name(program), "--help"], capture_output=True, text=True, check=True)
        assert shown.stdout.startswith(f"Usage: {program} ")
    if name == "clutchdiag":
        without = alone.run("-c", "from diag_service.cli import main; main(['--help'])", cwd=tmp_path).out
        run = alone.run("-c", "from ecu_emulator.cli import main; main(['run', '--help'])", cwd=tmp_path).out
        later = ("dtc", "scan", "--diagnostics", "--answers-like", "--doip")
        assert [word for word in later if word in without + run] == []
