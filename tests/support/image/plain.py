"""The image's own steps in a plain folder: what the Dockerfile says, without an engine, an index and another user.

Stand-ins replace only what cannot be had here. ``pip`` and ``uv`` fetch nothing: uv builds and installs the project as
it is told, and of what else is installed here exactly that becomes visible which the installed project asks for with
the extras that were named. ``useradd`` makes no user and ``install`` gives nothing to one.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path
from typing import Any

from numba.core.caching import UserProvidedCacheLocator
from packaging.requirements import Requirement

from tests.support.distributions import PACKAGES, modules_of
from tests.support.image.context import context_files
from tests.support.image.dockerfile import Copy, Instruction, Stage, read_stages

PROJECT = "clutchdiag"
NAMES = {"": PROJECT, "canlog": "canlog", "workshop": f"{PROJECT}-workshop", "fleet": f"{PROJECT}-fleet"}
ABSOLUTE = re.compile(
    r"(?<![\w./}])/(?=(?:opt|src|tmp|var)\b)"
)  # folders of the image, /dev and /bin are the machine's
INSTALLED = re.compile(r"(?<=[ \"])\.(?:/(\w+))?(?:\[([\w, -]+)\])?(?=[ \"]|$)")  # a folder of the checkout, its extras
LIMIT_S = 300.0

_STAND_INS = {
    "python": """if [ "$*" = "-m venv {root}/opt/uv" ]; then
  mkdir -p {root}/opt/uv/bin && cp {bin}/pip {bin}/uv {root}/opt/uv/bin
else
  exec {python} "$@"
fi""",
    "pip": "exit 0",
    "uv": 'PYTHONPATH={builder} exec {python} -m uv "$@" --offline --no-deps --no-build-isolation',
    "useradd": "exit 0",
    "install": """[ "$1" = -d ] || exit 1
shift
while [ $# -gt 0 ]; do
  case "$1" in
    -o | -g) shift 2 ;;
    *) mkdir -p "$1" && shift ;;
  esac
done""",
}


class PlainImage:
    """A folder in which the stages of a Dockerfile were carried out."""

    def __init__(self, source: Path, root: Path, kernels: Path) -> None:
        """Carry out the stages of ``source``, if ``root`` has not got them; ``kernels``: numba's cache of them."""
        self.root = root
        self.kernels = kernels
        self.stages = read_stages(source / "Dockerfile")
        self._source = source
        self._folder = root
        self.environment = {
            "PATH": os.pathsep.join((str(root / "stand-ins"), os.environ.get("PATH", os.defpath))),
            "HOME": str(root / "nowhere"),
        }
        self._is_made = (root / "made").exists()
        self._files = () if self._is_made else tuple(context_files(source))
        if not self._is_made:
            (root / "tmp").mkdir(parents=True)
            self.path(f"/var/cache/{PROJECT}").mkdir(parents=True)
            self._make_stand_ins()
        for stage in self.stages:
            self._carry_out(stage)
        (root / "made").touch()

    def run(self, *words: str, folder: Path | None = None, **more: str) -> "subprocess.CompletedProcess[str]":
        """Run a program of the image in its environment, with more variables perhaps, in a folder without sources."""
        program = shutil.which(words[0], path=self.environment["PATH"]) or words[0]
        return self._run(program, *words[1:], folder=folder, **more)

    def path(self, inside: str) -> Path:
        """Return where a path of the image is here."""
        return Path(self.mapped(inside))

    def mapped(self, text: str) -> str:
        """Return a text with the image's paths as they are here."""
        return ABSOLUTE.sub(f"{self.root}/", text)

    def _run(self, *words: str, folder: Path | None = None, **more: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            words, cwd=folder or self._folder, env={**self.environment, **more}, capture_output=True, text=True,
            check=False, timeout=LIMIT_S,
        )  # fmt: skip

    def _carry_out(self, stage: Stage) -> None:
        self._folder = self.root / "work"
        self._folder.mkdir(exist_ok=True)
        for entry in stage.instructions:
            match entry.name:
                case "WORKDIR":
                    self._folder = self.path(entry.text)
                    self._folder.mkdir(parents=True, exist_ok=self._is_made)
                case "ENV":
                    self._set(entry)
                case "COPY" if not self._is_made:
                    self._copy(entry.copy)
                case "RUN" if not self._is_made:
                    done = self._run("sh", "-ec", self.mapped(entry.text))
                    assert done.returncode == 0, f"RUN {entry.text}\n{done.stdout}\n{done.stderr}"

    def _copy(self, copy: Copy) -> None:
        """Copy from the context; what another stage made is in this folder already."""
        if copy.stage is not None:
            assert all(self.path(source).exists() for source in copy.sources)
            self._show_packages()
            return
        for file in self._files:
            for source in copy.sources:
                if f"{file}/".startswith(f"{source}/"):
                    inside = Path(file).relative_to(source) if file != source else Path(Path(file).name)
                    target = self._folder / copy.target / inside
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(self._source / file, target)

    def _set(self, entry: Instruction) -> None:
        for word in entry.words:
            name, _, value = word.partition("=")
            old = self.environment.get(name, "")
            self.environment[name] = self.mapped(value).replace(f"${name}", old)

    def _make_stand_ins(self) -> None:
        builder = self.root / "builder"
        _link(distribution("setuptools"), builder)
        names = {"root": self.root, "bin": self.root / "stand-ins", "python": sys.executable, "builder": builder}
        (self.root / "stand-ins").mkdir()
        for name, text in _STAND_INS.items():
            path = self.root / "stand-ins" / name
            for key, value in names.items():
                text = text.replace("{" + key + "}", str(value))  # noqa: PLW2901 - filled in place by place
            path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
            path.chmod(0o755)

    def _show_packages(self) -> None:
        """Make visible what the installed project asks for, with the extras of the install step."""
        (site,) = self.path("/opt").glob(f"{PROJECT}/lib/python*/site-packages")
        for name, extras in self.installed.items():
            (own,) = distributions(name=name, path=[str(site)])
            for found in _needed(own, extras):
                _link(found, site)
        self._share_kernels(site)

    def _share_kernels(self, site: Path) -> None:
        """Let numba find here the machine code of the same sources in the checkout, and leave there what it adds."""
        name_of: Any = UserProvidedCacheLocator  # numba says nothing of types
        cache = self.path(f"/var/cache/{PROJECT}/{self.kernels.name}")
        cache.mkdir()
        for package, folder in PACKAGES.items():
            for module in {path.parent: path for path in modules_of(package)}.values():
                shared = self.kernels / name_of.get_suitable_cache_subpath(str(module))
                shared.mkdir(exist_ok=True)
                here = name_of.get_suitable_cache_subpath(str(site / package / module.relative_to(folder)))
                (cache / here).symlink_to(shared, target_is_directory=True)

    @property
    def installed(self) -> dict[str, tuple[str, ...]]:
        """Distributions that the install step names, with their extras."""
        steps = " ".join(entry.text for stage in self.stages for entry in stage.instructions if entry.name == "RUN")
        return {NAMES[folder]: tuple(extras.split(",")) for folder, extras in INSTALLED.findall(steps)}


def _needed(own: Distribution, extras: Iterable[str]) -> list[Distribution]:
    """Return everything that a distribution needs with some extras, and what that needs, as it is installed here."""
    found: dict[tuple[str, str], Distribution] = {}
    asked = [(own, extra) for extra in ("", *extras)]
    while asked:
        who, extra = asked.pop()
        for text in who.requires or ():
            requirement = Requirement(text)
            if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
                continue
            if requirement.name in NAMES.values():
                continue
            for wanted in ("", *requirement.extras):
                if (requirement.name, wanted) not in found:
                    found[requirement.name, wanted] = distribution(requirement.name)
                    asked.append((found[requirement.name, wanted], wanted))
    return list(found.values())


def _link(found: Distribution, site: Path) -> None:
    """Let the files of an installed distribution appear in another folder of packages."""
    site.mkdir(exist_ok=True)
    for name in {file.parts[0] for file in found.files or () if file.parts[0] not in {"..", "__pycache__"}}:
        if not (site / name).exists():
            (site / name).symlink_to(Path(str(found.locate_file(name))))
