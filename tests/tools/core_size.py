"""How much code the core needs: all that service, logs, emulator and ingest import, directly or not, in lines."""

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path

import grimp

from tests.support.distributions import PACKAGES

CORE: Mapping[str, tuple[str, ...]] = {
    "service": ("diag_service.service.application", "diag_service.service.bus_run", "diag_service.service.recorded"),
    "logs": ("canlog.whole_log",),
    "emulator": ("ecu_emulator.live",),
    "ingest": ("fleet_backend.ingest",),
}
ANNEXES = ("workshop", "fleet_backend.office", "fleet_backend.page", "fleet_backend.ageing", "fleet_backend.alarms")


def import_graph() -> grimp.ImportGraph:
    """Return who imports whom, but for what only type checkers see."""
    return grimp.build_graph(*PACKAGES, cache_dir=None, exclude_type_checking_imports=True)


def closure(graph: grimp.ImportGraph, modules: Iterable[str]) -> set[str]:
    """Return modules with all that they import, directly or not, and the packages in which those stand."""
    waiting, found = list(modules), set[str]()
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += graph.find_modules_directly_imported_by(name)
            waiting += [name.rpartition(".")[0]] if "." in name else []
    return found


def line_count(modules: Iterable[str]) -> int:
    """Return the lines of the files of modules."""
    specs = (find_spec(name) for name in modules)
    return sum(len(Path(spec.origin).read_bytes().splitlines()) for spec in specs if spec is not None and spec.origin)
