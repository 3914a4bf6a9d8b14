"""The distributions of this repository: where each stands, what it holds and what it requires."""

import tomllib
from collections.abc import Iterator, Mapping
from importlib.metadata import distribution
from pathlib import Path
from typing import Any, Final

from packaging.requirements import Requirement

ROOT: Final = Path(__file__).parents[2]
FOLDERS: Final[Mapping[str, Path]] = {
    "canlog": ROOT / "canlog",
    "can-silkit": ROOT / "can_silkit",
    "clutchdiag": ROOT,
    "clutchdiag-workshop": ROOT / "workshop",
    "clutchdiag-fleet": ROOT / "fleet",
}
SOURCES: Final[Mapping[str, Path]] = {
    name: ROOT if folder == ROOT else folder / "src" for name, folder in FOLDERS.items()
}
"""Where the packages of each are; these folders are what is looked for modules in."""
PACKAGES: Final[Mapping[str, Path]] = {
    path.parent.name: path.parent
    for name, folder in SOURCES.items()
    for path in sorted(folder.glob("*/__init__.py"))
    if folder != ROOT or (path.parent / "py.typed").is_file()
}
"""Where each package of the product is; of folders at the root those that say their types."""


def modules_of(package: str) -> Iterator[Path]:
    """Yield the files of a package; what is no package of the product is a folder at the root."""
    yield from sorted(PACKAGES.get(package, ROOT / package).rglob("*.py"))


def pyproject(name: str = "clutchdiag") -> dict[str, Any]:
    """Return what a distribution says of itself."""
    table: dict[str, Any] = tomllib.loads((FOLDERS[name] / "pyproject.toml").read_text(encoding="utf-8"))
    return table


def requirements(name: str, *extras: str) -> list[str]:
    """Return what an installed distribution requires from elsewhere, without and with these extras."""
    wanted = [Requirement(text) for text in distribution(name).requires or ()]
    held = [
        one
        for one in wanted
        if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in ("", *extras))
    ]
    others = [
        f"{one.name}{one.specifier}" if not one.extras else f"{one.name}[{','.join(one.extras)}]{one.specifier}"
        for one in held
        if one.name not in FOLDERS
    ]
    return [*others, *(text for one in held if one.name in FOLDERS for text in requirements(one.name, *one.extras))]


def extras_of(name: str) -> list[str]:
    """Return the names of the extras of a distribution."""
    return distribution(name).metadata.get_all("Provides-Extra") or []
