"""Every keyword-only record of some packages with one more field, which has a default: as a later program has them.

``python -m tests.support.wider_records MODULE WORDS`` imports a module so, and calls its ``play`` with the words. It
prints as JSON what that returns, and the names of all records that were made wider.
"""

import ast
import json
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from types import CodeType, ModuleType
from typing import Final

FIELD: Final = "a_later_one"
DEFAULT: Final = "later"
PACKAGES: Final = ("fleet_backend", "clutch_results", "fleet_contract", "diag_service")


class Widening(MetaPathFinder):
    """Finds modules of some packages, and makes their records wider when it loads them; ``records`` are their names."""

    def __init__(self, packages: Sequence[str]) -> None:
        self._packages = tuple(packages)
        self.records: list[str] = []

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how a module of these packages is loaded; None for all others."""
        if not any(f"{fullname}.".startswith(f"{package}.") for package in self._packages):
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        specs = (finder.find_spec(fullname, path, target) for finder in others)
        spec = next(filter(None, specs), None)
        if spec is not None and type(spec.loader) is SourceFileLoader:
            spec.loader = _Loader(fullname, spec.loader.path, self.records)
        return spec


class _Loader(SourceFileLoader):
    """Compiles a module whose records have one more field."""

    def __init__(self, name: str, path: str, records: list[str]) -> None:
        super().__init__(name, path)
        self._records = records

    def get_code(self, fullname: str) -> CodeType:
        """Return the module compiled anew: what Python keeps beside the source is of the records as they are."""
        tree = ast.parse(self.get_data(self.path))
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and any(map(_is_of_keywords, node.decorator_list)):
                node.body += ast.parse(f"{FIELD}: str = {DEFAULT!r}").body
                self._records.append(f"{fullname}.{node.name}")
        return compile(ast.fix_missing_locations(tree), self.path, "exec", dont_inherit=True)


def _is_of_keywords(decorator: ast.expr) -> bool:
    """Return whether a decorator makes a record that is made by names alone."""
    if not (isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "dataclass"):
        return False
    return any(word.arg == "kw_only" and ast.unparse(word.value) == "True" for word in decorator.keywords)


def main() -> None:
    """Make records wider, before anything imports them, and play."""
    module, *words = sys.argv[1:]
    widening = Widening(PACKAGES)
    sys.meta_path.insert(0, widening)
    answers = import_module(module).play(*words)
    sys.stdout.write(json.dumps({**answers, "records": widening.records}))


if __name__ == "__main__":
    main()
