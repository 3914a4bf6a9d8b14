"""Tables that were read once are read alike: columns, units, notes, counts, every time and every value."""

import json

import pytest

from canlog_tests.logs.table_goldens import PATH, outcome, tables

GOLDENS = json.loads(PATH.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", tables())
def test_a_table_is_read_as_it_was(name: str) -> None:
    assert outcome(tables()[name]) == GOLDENS[name]
