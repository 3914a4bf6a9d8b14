"""The wheels that ``make wheels`` builds: each holds its own packages, and works where nothing of the others is."""

import subprocess
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.support.distributions import FOLDERS, PACKAGES, SOURCES, pyproject, requirements
from tests.support.plain_install import distributions_of, linked_environment
from tests.support.wheels import built_wheels, install

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


@pytest.fixture(name="wheels", scope="module")
def _wheels(shared_folder: Path) -> dict[str, Path]:
    return built_wheels(shared_folder)


@pytest.mark.parametrize("name", FOLDERS)
def test_a_wheel_holds_its_own_packages_and_names_the_others_by_version(wheels: dict[str, Path], name: str) -> None:
    with ZipFile(wheels[name]) as wheel:
        held = {place for place in wheel.namelist() if ".dist-info/" not in place}
        (place,) = (place for place in wheel.namelist() if place.endswith("/METADATA"))
        metadata = wheel.read(place).decode()
    own = [folder for folder in PACKAGES.values() if folder.parent == SOURCES[name]]
    modules = {path.relative_to(SOURCES[name]).as_posix() for folder in own for path in folder.rglob("*.py")}
    assert {place for place in held if place.endswith(".py")} == modules
    typed = {f"{folder.name}/py.typed" for folder in own}
    assert {place for place in held if place.endswith("py.typed")} == typed
    assert name != "canlog" or held == modules | typed  # a library without data
    assert "file:" not in metadata
    assert [one for one in BELOW[name][:1] if f"Requires-Dist: {one}>=0.9" not in metadata] == []


@pytest.mark.parametrize("name", FOLDERS)
def test_a_wheel_works_with_what_it_requires_and_nothing_else(
    wheels: dict[str, Path], tmp_path: Path, name: str
) -> None:
    needed = [name, *BELOW[name]]
    linked_environment(tmp_path / "env", distributions_of(requirements(name, *EXTRAS.get(name, ()))))
    alone = install(tmp_path / "env", *(wheels[one] for one in needed))
    packages = [folder.name for folder in PACKAGES.values() if folder.parent == SOURCES[name]]
    told = alone.run("-c", LOAD_ALL, *packages, cwd=tmp_path)
    assert told.status == 0, told.err
    assert [place for place in told.out.splitlines() if not Path(place).is_relative_to(tmp_path)] == []
    helps = {}
    for program in pyproject(name)["project"].get("scripts", {}):
        shown = subprocess.run([alone.python.with_name(program), "--help"], capture_output=True, text=True, check=True)
        assert shown.stdout.startswith(f"Usage: {program} ")
        helps[program] = shown.stdout
    if name == "clutchdiag":
        (run,) = alone.run_all("ecu_emulator.cli", [["run", "--help"]], cwd=tmp_path)
        later = ("dtc", "scan", "--diagnostics", "--answers-like", "--doip")
        assert [word for word in later if word in helps["diag-service"] + run.out] == []
