"""docs/controller-tables.md says what the controller's table says, and what the controller answers."""

from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.tools.uds_tables import DOCUMENT, written
from tests.unit.ecu_emulator.diagnostics.bench import Bench


def test_the_tables_of_the_document_are_those_of_the_code() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert text.count("<!-- table ") == 8
    assert written(text, shipped_table()) == text


def test_the_dialogue_of_the_document_is_what_the_controller_answers() -> None:
    _, _, dialogue = DOCUMENT.read_text(encoding="utf-8").partition("<!-- dialogue -->")
    bench, said = Bench(table=shipped_table()), ""
    bench.monitor("P0811", TestResult.FAILED)
    for line in [line for line in dialogue.splitlines() if line.startswith("7E")]:
        told = line[5:69].strip().lower()
        if line.startswith("7E1"):
            said = bench.ask(told)
            continue
        begins, _, size = told.partition(" ... ")
        assert said.startswith(begins)
        assert len(bytes.fromhex(said)) == (int(size.removesuffix(" bytes")) if size else len(bytes.fromhex(begins)))
        if said == "7f 31 78":
            bench.finish(0x0301)
            said = bench.wait(0.1)
