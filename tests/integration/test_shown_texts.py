"""What programs show to people, held against rules of plain English."""

import pytest

from tests.tools.shown_texts import ShownText, main, shown_texts


def test_no_text_that_a_program_shows_breaks_a_rule_of_plain_english() -> None:
    texts = shown_texts()
    assert len(texts) > 2000, "most texts were not found"
    assert [(text.path, text.line, finding) for text in texts for finding in text.findings()] == []


@pytest.mark.parametrize(
    "riddle",
    [
        "its fluid lets it shudder",
        "its service never said that it is there",
        "Half by, most by: until then it has to be changed with a probability of 50 and 90 %",
        "raised by rules; those of one vehicle and rule follow each other",
        "Nothing in the fleet is like that.",
        "mu-v slope negative with probability 1.000",
        "50 % of its margin against shudder are gone",
        "running estimate from 1 shifts",
        "It is tried again; so may you, in a few seconds.",
        " ".join(["word"] * 40),
    ],
)
def test_what_made_people_read_twice_is_found(riddle: str) -> None:
    assert list(ShownText(path="program.py", line=1, text=riddle).findings()) != []


def test_the_command_lists_the_texts_of_a_package_with_their_places(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet_link"]) == 0
    out = capsys.readouterr().out
    assert "fleet_link/address.py" in out
    assert "certificates need a broker at mqtts://" in out
    assert out.endswith(" 0 findings\n")
