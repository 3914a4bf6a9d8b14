"""docs/controller-tables.md says what the controller's table says."""

from ecu_emulator.diagnostics.table_file import shipped_table
from tests.tools.uds_tables import DOCUMENT, written


def test_the_tables_of_the_document_are_those_of_the_code() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert text.count("<!-- table ") == 8
    assert written(text, shipped_table()) == text
