"""Libraries that only an extra brings, and the words that say how to install one."""

import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

from canlog.errors import ExtraMissingError


def load_extra(module: str, what: str, extra: str = "", folder: str = "./canlog") -> Any:  # noqa: ANN401 - a module of any library
    """Return a module of an optional library; raises ExtraMissingError if it is not installed.

    Parameters
    ----------
    module : str
        Its name.
    what : str
        Who needs it, for people: ``Parquet needs pyarrow``.
    extra : str
        Which extra brings it; empty: it is installed by its own name.
    folder : str
        Of the distribution that has the extra, in the checkout.
    """
    try:
        return import_module(module)
    except ImportError as exc:
        raise (
            extra_missing(what, extra, folder) if extra else ExtraMissingError(f"{what}: pip install {module}")
        ) from exc


def load_asammdf(what: str) -> Any:  # noqa: ANN401 - an untyped library
    """Return asammdf, as `load_extra` does; a program may have kept itself from loading it before it is needed."""
    if sys.modules.get("asammdf", ...) is None:
        del sys.modules["asammdf"]
    wait_with("polars")  # which asammdf takes along, and reads no frame with
    return load_extra("asammdf", what, "mf4")


def extra_missing(what: str, extra: str, folder: str = "./canlog") -> ExtraMissingError:
    """Return the error that says what to install: an extra of a distribution in the checkout."""
    return ExtraMissingError(f"{what}: pip install '{folder}[{extra}]' in the checkout")


class _LazyFinder:
    """Finds some modules as the system does, but lets them wait."""

    def __init__(self, names: frozenset[str]) -> None:
        self._names = names

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a module that waits if it is one of them."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname in self._names else None
        if spec is not None and spec.loader is not None:
            from importlib.util import LazyLoader  # noqa: PLC0415 - every program imports this module before it heeds Ctrl-C

            spec.loader = LazyLoader(spec.loader)
        return spec


def wait_with(*names: str) -> None:
    """Let modules wait that are not yet imported: they are there, and are executed when something of them is used."""
    sys.meta_path.insert(0, _LazyFinder(frozenset(names)))


def on_demand(package: str, file: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and ``__dir__`` of a package whose names are imported when they are first used.

    The names are those that its ``if TYPE_CHECKING:`` block imports.

    Parameters
    ----------
    package
        Its name.
    file
        Its source.
    """

    @cache
    def homes() -> dict[str, str]:
        import ast  # noqa: PLC0415 - every program imports this module before it heeds Ctrl-C
        from pathlib import Path  # noqa: PLC0415 - see above

        blocks = (node for node in ast.parse(Path(file).read_bytes()).body if isinstance(node, ast.If))
        imports = (node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom))
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def get(name: str) -> object:
        if name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes()[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes()})

    return get, names
