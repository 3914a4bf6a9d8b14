"""What the documents' figures of readability count."""

import math

import pytest

from tests.tools.readability import NOTHING, pages, readability

PAGE = """# A heading of no sentence

The clutch slips. It carries torque, and [the fluid](fluid.md) ages.

| a table | is no prose |
|---|---|

```sh
diag-service analyze drive.log   # nor is a command
```

    (1)  an equation

- One point
- Another one

<!-- table data -->
Written by a program.
<!-- end -->
"""


def test_prose_is_counted_without_tables_commands_and_what_programs_write() -> None:
    found = readability(PAGE)
    assert (found.sentences, found.prose_words) == (4, 14)
    assert found.long_sentences == 0
    assert readability(PAGE + "\nOne " + "more " * 40 + "word.\n").long_sentences == 1


def test_short_words_in_short_sentences_are_easy() -> None:
    easy = readability("The car is new. The oil is old. We change it.")
    hard = readability("Considerable experimental investigations demonstrated irreversible thermochemical degradation.")
    assert easy.ease > 90.0
    assert hard.ease < 30.0
    assert math.isnan(NOTHING.ease)


def test_pages_are_found_as_they_were() -> None:
    now = pages()
    assert {"README.md", "docs/usage.md"} <= now.keys()
    assert not any("decisions" in name for name in now)


@pytest.mark.parametrize("word", ["clutch", "fluid"])
def test_a_word_has_a_syllable(word: str) -> None:
    assert readability(f"{word} {word}.").syllables >= 2
