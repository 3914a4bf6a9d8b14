"""What a stranger does with the wheel, in a fresh environment outside the checkout: ``python -m tests.tools.fresh``.

Builds the wheel, installs it in the versions of requirements.lock and prints what it takes; adds its extras, and runs
the Python page, the notebook, the worked example with and without its faults, analyze, report and history. Another
Python is named by ``--python``.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from tests.support.documents import ROOT, page_text
from tests.unit.test_packaging import PACKAGES, PIN, lock_lines

EXTRAS: Final = "diagnostics,parquet,test,uds"
BESIDE: Final = ("matplotlib", "pandas", "polars")  # which the page and the notebook use
SOURCES: Final = ("pyproject.toml", "README.md", "LICENSE", *PACKAGES)
FAULTS: Final = ("none", "drop", "alter", "swap")
MOST_MB: Final = 350.0  # of an installation without extras
_BLOCK: Final = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
# One block after the other; the processes that a block starts import this file and find nothing to do.
_PAGE: Final = """if __name__ == "__main__":
    names = {{"__name__": "__main__"}}
    for block in {blocks!r}:
        exec(block, names)
"""
_LEFT_OUT: Final = shutil.ignore_patterns("__pycache__", "build", "*.egg-info", ".*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fresh:
    """An environment, and the folder in which its programs run."""

    programs: Path
    folder: Path

    def run(self, what: str, *words: str, status: int = 0, **variables: str) -> None:
        """Run a program and print how long it took; raises SystemExit if it ends otherwise than it should."""
        kept = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "VIRTUAL_ENV"}}
        began_s = time.perf_counter()
        done = subprocess.run(
            [str(self.programs / words[0]), *words[1:]], cwd=self.folder, capture_output=True, text=True, check=False,
            env={**kept, "PATH": f"{self.programs}{os.pathsep}{kept.get('PATH', '')}", **variables},
        )  # fmt: skip
        print(f"{what:<42} status {done.returncode}  {time.perf_counter() - began_s:6.1f} s", flush=True)
        if done.returncode != status:
            raise SystemExit(f"{what}: status {status} was expected\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}")


def constraints() -> str:
    """Return the versions of the lock, without its hashes."""
    found = [match for line in lock_lines() if (match := PIN.fullmatch(line))]
    return "".join(f"{match[1]}=={match[2]}{match[3] or ''}\n" for match in found)


def pip(*words: str | Path) -> None:
    """Run pip of this environment; raises SystemExit if it fails."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)


def megabytes(folder: Path) -> float:
    """Return how much a folder holds [MB]."""
    return sum(path.lstat().st_size for path in folder.rglob("*")) / 1e6


def wheel(folder: Path) -> Path:
    """Build the wheel from a copy, for building leaves files beside the sources."""
    sources = folder / "sources"
    sources.mkdir()
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, sources / name, ignore=_LEFT_OUT)
        else:
            shutil.copyfile(source, sources / name)
    pip("wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder, sources)
    (built,) = folder.glob("clutchdiag-*.whl")
    return built


@contextmanager
def fresh_environment(python: str) -> Iterator[Fresh]:
    """Make an environment with the wheel and what a user adds to it; it goes with the block."""
    with TemporaryDirectory(prefix="fresh-") as name:
        folder = Path(name)
        built = wheel(folder)
        subprocess.run([python, "-m", "venv", str(folder / "env")], check=True)
        versions = folder / "constraints.txt"
        versions.write_text(constraints(), encoding="utf-8")
        programs = folder / "env" / "bin"
        before_mb = megabytes(folder / "env")
        install = ("--python", programs / "python", "install", "-q", "-c", versions)
        pip(*install, built)
        size_mb = megabytes(folder / "env") - before_mb
        print(f"without extras it takes {size_mb:.0f} MB; at most {MOST_MB:.0f} are promised", flush=True)
        if size_mb > MOST_MB:
            raise SystemExit("it takes too much")
        pip(*install, f"{built}[{EXTRAS}]", *BESIDE)
        work = folder / "work"
        work.mkdir()
        yield Fresh(programs=programs, folder=work)


def write_inputs(folder: Path) -> None:
    """Write what is run: the page and the notebook as programs, the worked example, a database."""
    shutil.copyfile(ROOT / "dbc" / "dct.dbc", folder / "car.dbc")
    (folder / "page.py").write_text(_PAGE.format(blocks=_BLOCK.findall(page_text("docs/python.md"))), encoding="utf-8")
    notebook: Mapping[str, Sequence[Mapping[str, object]]] = json.loads(page_text("examples/notebook.ipynb"))
    lines = (
        line
        for cell in notebook["cells"]
        if cell["cell_type"] == "code"
        for line in (*"".join(map(str, _sequence(cell["source"]))).splitlines(), "")
    )
    (folder / "notebook.py").write_text("\n".join(line for line in lines if not line.startswith("%")), encoding="utf-8")
    shutil.copytree(ROOT / "examples" / "gateway", folder / "gateway", ignore=_LEFT_OUT)


def _sequence(value: object) -> Sequence[object]:
    return value if isinstance(value, list) else [value]


def use(fresh: Fresh) -> None:
    """Do all of it."""
    write_inputs(fresh.folder)
    fresh.run("its Python", "python", "--version")
    fresh.run("docs/python.md", "python", "page.py")
    fresh.run("examples/notebook.ipynb", "python", "notebook.py", MPLBACKEND="agg")
    for fault in FAULTS:
        status = 0 if fault == "none" else 1
        words = ("gateway", "-q", "-p", "no:cacheprovider")
        fresh.run(f"examples/gateway, fault: {fault}", "pytest", *words, status=status, GATEWAY_FAULT=fault)
    drive = ("record", "aged.log", "--scenario", "case2", "--cycles", "2", "--seed", "7", "--force")
    fresh.run("ecu-emulator record", "ecu-emulator", *drive)
    fresh.run("diag-service analyze --store", "diag-service", "analyze", "aged.log", "--store", "car.sqlite")
    fresh.run("diag-service report", "diag-service", "report", "aged.log", "-o", "report.html")
    fresh.run("diag-service history", "diag-service", "history", "car.sqlite", "--json")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default=sys.executable, metavar="PYTHON", help="default: this one")
    options = parser.parse_args()
    with fresh_environment(options.python) as fresh:
        use(fresh)


if __name__ == "__main__":
    main()
