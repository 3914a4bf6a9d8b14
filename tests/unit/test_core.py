"""The core stands without its annexes, and neither core nor product grows: ``size.toml`` is the ratchet."""

import tomllib
from pathlib import Path

from tests.tools.core_size import ANNEXES, CORE, closure, import_graph, line_count

SIZE = tomllib.loads((Path(__file__).parent / "size.toml").read_text(encoding="utf-8"))


def test_the_core_imports_no_annex_and_does_not_grow() -> None:
    core = closure(import_graph(), [one for modules in CORE.values() for one in modules])
    assert [name for name in core if name.startswith(ANNEXES)] == []
    assert line_count(core) <= SIZE["core_lines"]


def test_the_product_does_not_grow() -> None:
    modules = import_graph().modules
    assert len(modules) <= SIZE["product_modules"]
    assert line_count(modules) <= SIZE["product_lines"]
