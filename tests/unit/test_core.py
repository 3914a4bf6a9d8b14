"""The core stands without its annexes: it imports none, and all of it is a bounded part of the house."""

from tests.tools.core_size import ANNEXES, CORE, closure, import_graph, line_count

CORE_LINES = 51_630


def test_the_core_imports_no_annex_and_does_not_grow() -> None:
    core = closure(import_graph(), [one for modules in CORE.values() for one in modules])
    assert [name for name in core if name.startswith(ANNEXES)] == []
    assert line_count(core) <= CORE_LINES
