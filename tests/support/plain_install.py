"""An interpreter that has what all distributions bring without an extra, and runs of our programs in it."""

import json
import os
import subprocess
import venv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Final

from packaging.requirements import Requirement

from tests.support.distributions import FOLDERS, ROOT, SOURCES, extras_of, requirements
from tests.unit.test_packaging import normal

RUN_S: Final = 300.0  # reached by what hangs only
_ELSEWHERE: Final = frozenset({"PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV"})
_DRIVER: Final = """
import contextlib, importlib, io, json, sys
module, runs = sys.argv[1], json.loads(sys.argv[2])
outcomes = []
for words in runs:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = importlib.import_module(module).main(words)
        except SystemExit as exc:
            status = exc.code
    outcomes.append([status, out.getvalue(), err.getvalue()])
print(json.dumps(outcomes))
"""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one run."""

    status: int
    out: str
    err: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainInstall:
    """The interpreter."""

    python: Path

    def run(self, *words: str, cwd: Path = ROOT, **environment: str) -> Outcome:
        """Run it with these arguments, in an environment with these variables besides."""
        kept = {name: value for name, value in os.environ.items() if name not in _ELSEWHERE}
        done = subprocess.run(
            [self.python, *words],
            cwd=cwd,
            env={**kept, "COLUMNS": "200", **environment},
            capture_output=True,
            text=True,
            timeout=RUN_S,
            check=False,
        )
        return Outcome(done.returncode, done.stdout, done.stderr)

    def run_all(self, module: str, runs: Sequence[Sequence[str]], cwd: Path = ROOT) -> list[Outcome]:
        """Call the ``main`` of a module once for each list of words, in one process, which saves its start."""
        done = self.run("-c", _DRIVER, module, json.dumps([list(words) for words in runs]), cwd=cwd)
        assert done.status == 0, done.err
        return [Outcome(*outcome) for outcome in json.loads(done.out)]


def plain_install(folder: Path) -> PlainInstall:
    """Make the interpreter in a folder: links to what is required, found from our metadata, and our sources."""
    site = linked_environment(folder, core_distributions())
    for name in FOLDERS:
        ours = Path(str(distribution(name).locate_file("")))
        (information,) = ours.glob(f"{name.replace('-', '_')}-*.dist-info")
        (site / information.name).symlink_to(information)
    (site / "sources.pth").write_text("\n".join(map(str, SOURCES.values())) + "\n", encoding="utf-8")
    return PlainInstall(python=folder / "bin" / "python")


def linked_environment(folder: Path, names: Iterable[str]) -> Path:
    """Make an environment in a folder with links to these distributions; return its site-packages."""
    venv.EnvBuilder(symlinks=True, with_pip=False).create(folder)
    return linked(next((folder / "lib").glob("python*")) / "site-packages", names)


def linked(site: Path, names: Iterable[str]) -> Path:
    """Link to these distributions in a folder that modules are looked for in, and return it."""
    site.mkdir(exist_ok=True)
    for name in names:
        for entry in _top_entries(distribution(name)):
            (site / entry.name).symlink_to(entry)
    return site


def core_distributions() -> set[str]:
    """Return the names of what all distributions require without any extra, and of what that requires."""
    return distributions_of(text for name in FOLDERS for text in requirements(name))


def distributions_of(requirements: Iterable[str]) -> set[str]:
    """Return the names of some requirements, and of what they require."""
    found: set[str] = set()
    waiting = [Requirement(text) for text in requirements]
    while waiting:
        requirement = waiting.pop()
        name = normal(requirement.name)
        if name in found:
            continue
        found.add(name)
        for text in distribution(name).requires or []:
            inner = Requirement(text)
            extras = requirement.extras or {""}
            if inner.marker is None or any(inner.marker.evaluate({"extra": extra}) for extra in extras):
                waiting.append(inner)
    return found


def extra_modules() -> set[str]:
    """Return the top-level modules that only extras bring."""
    core = core_distributions()
    texts = [text for name in FOLDERS for text in requirements(name, *(set(extras_of(name)) - {"dev"}))]
    names = {normal(Requirement(text).name) for text in texts}
    return {module for name in names - core for module in _modules(_top_entries(distribution(name)))}


def _top_entries(found: Distribution) -> list[Path]:
    """Return the files and folders that a distribution puts into site-packages."""
    if found.files is None:
        raise PackageNotFoundError(found.name)
    tops = {path.parts[0] for path in found.files if path.parts[0] not in {"..", "__pycache__"}}
    return sorted(Path(str(found.locate_file(top))) for top in tops)


def _modules(entries: Iterable[Path]) -> set[str]:
    names = {entry.name.partition(".")[0] for entry in entries if entry.is_dir() or ".py" in entry.name}
    return {name for name in names if name.isidentifier() and not name.startswith("_")}
