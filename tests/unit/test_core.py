"""The core stands without its annexes."""

from tests.tools.core_size import ANNEXES, CORE, closure, import_graph


def test_the_core_imports_no_annex() -> None:
    core = closure(import_graph(), [one for modules in CORE.values() for one in modules])
    assert [name for name in core if name.startswith(ANNEXES)] == []
