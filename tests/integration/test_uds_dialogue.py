"""A dialogue with the controller, read by programs that share no code with it."""

from pathlib import Path

from tests.support.uds.dialogue import held_dialogue
from tests.tools.uds_dialogue import DOCUMENT, read_by_scapy, written


def test_the_dialogue_in_the_documents_is_what_another_reader_reads(tmp_path: Path) -> None:
    dialogue, log = held_dialogue(), tmp_path / "dialogue.log"
    log.write_text(dialogue.log, encoding="ascii")
    told = read_by_scapy(log)
    assert [(one["can_id"], bytes.fromhex(one["bytes"])) for one in told] == dialogue.messages
    text = DOCUMENT.read_text(encoding="utf-8")
    assert written(text, told) == text
