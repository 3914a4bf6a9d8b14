"""Modules of libraries that are executed when they are first used: importing what needs them takes less time."""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Final

TESTER: Final = "cantools.tester"  # a live bus for cantools, which takes all of python-can along: 60 ms


class _Late(MetaPathFinder):
    """Finds some modules as the system does, but lets them wait."""

    def __init__(self, names: frozenset[str]) -> None:
        self._names = names

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a module that waits if it is one of them."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname in self._names else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def wait_with(*names: str) -> None:
    """Let modules wait that are not yet imported: they are there, and are executed when something of them is used."""
    sys.meta_path.insert(0, _Late(frozenset(names)))
