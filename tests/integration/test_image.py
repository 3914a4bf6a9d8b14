"""The image's own steps, taken from the Dockerfile, in a plain folder, and its programs there."""

import ast
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from can import LogReader, MF4Writer

from tests.plugins.drives import SHIFT_COUNT
from tests.support.distributions import FOLDERS, PACKAGES, ROOT, modules_of, pyproject
from tests.support.image.plain import PlainImage

PROGRAMS = sorted(program for name in FOLDERS for program in pyproject(name)["project"].get("scripts", ()))
NOT_OF_PROGRAMS = {
    "_typeshed",
    "matplotlib",
    "pytest",
}  # for type checkers; pictures and fixtures of notebooks and tests


def test_every_program_runs(image: PlainImage) -> None:
    """Their help without the rest of the checkout is shown by test_wheels.py."""
    for program in PROGRAMS:
        done = image.run(program, "--version")
        assert (done.returncode, done.stderr) == (0, "")
        assert pyproject()["project"]["version"] in done.stdout


def test_a_log_of_asammdf_is_analysed(image: PlainImage, drive_log: Path, tmp_path: Path) -> None:
    """The drive that the image makes and analyses while it is built is a candump log."""
    with LogReader(drive_log) as messages, MF4Writer(tmp_path / "drive.mf4") as log:
        for message in messages:
            log.on_message_received(message)
    done = image.run("diag-service", "analyze", str(tmp_path / "drive.mf4"), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["shifts"]["by_status"]["valid"] == SHIFT_COUNT


def test_the_fleet_works(image: PlainImage) -> None:
    url = f"sqlite:///{image.path('/tmp/fleet.sqlite')}"  # noqa: S108 - of the image
    for words in (("fleet-backend", "migrate", "--database", url), ("fleet-backend", "table", "--database", url)):
        done = image.run(*words)
        assert done.returncode == 0, done.stderr


def test_what_is_compiled_stands_where_programs_look_for_it(image: PlainImage) -> None:
    (sources,) = Path(image.environment["NUMBA_CACHE_DIR"]).iterdir()
    assert len(sources.name) == 64  # a digest of the sources, and nothing beside it


def imported_names() -> Iterator[str]:
    """Yield every module that the sources import from outside, wherever in a file."""
    for package in PACKAGES.keys() - {"can_silkit"}:  # whose binding the image's Python is too old for
        for path in modules_of(package):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    yield from (alias.name for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.module is not None and not node.level:
                    yield node.module
                elif isinstance(node, ast.Call) and "import_module" in ast.unparse(node.func):
                    yield from (str(word.value) for word in node.args if isinstance(word, ast.Constant))


def test_the_extras_that_the_image_names_cover_every_import(image: PlainImage) -> None:
    names = sorted({name.partition(".")[0] for name in imported_names()} - sys.stdlib_module_names - NOT_OF_PROGRAMS)
    assert {"asammdf", "can", "numba", "pyarrow"} <= set(names)
    text = f"import importlib.util as u; print([n for n in {names} if u.find_spec(n) is None])"
    done = image.run("python", "-c", text)
    assert done.stdout.strip() == "[]", done.stdout


def test_nothing_of_the_clone_is_seen_from_the_image(image: PlainImage) -> None:
    done = image.run("python", "-c", "import clutch_model, canlog, sys; print(clutch_model.__file__, *sys.path)")
    assert str(ROOT) not in done.stdout
    assert str(image.root) in done.stdout.split()[0]


def test_the_image_runs_as_a_user_of_its_own_that_owns_its_folders(image: PlainImage) -> None:
    last = image.stages[-1]
    users = [entry.text for entry in last.instructions if entry.name == "USER"]
    assert users == ["10001:10001"]
    made = " ".join(entry.text for entry in last.instructions if entry.name == "RUN")
    assert "--user-group --uid 10001 clutchdiag " in made
    owned = made.split("install -d -o clutchdiag -g clutchdiag ")[1].split(" && ")[0].split()
    variables = last.environment
    assert variables["NUMBA_CACHE_DIR"] in owned
    assert os.path.join(variables["XDG_STATE_HOME"], "clutchdiag") in owned  # noqa: PTH118 - paths of the image
