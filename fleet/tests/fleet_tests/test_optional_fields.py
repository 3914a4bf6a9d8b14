"""A field that has a default is optional where rows of the database become records again."""

from dataclasses import MISSING, fields

import pytest

from clutch_results.records import EventConditions, EventFit
from fleet_backend.ageing.prognosis import estimate_of
from tests.support.fleet import fleet_result, row_of

OPTIONAL = [
    (group, field.name, field.default)
    for group, kind in (("conditions", EventConditions), ("fit", EventFit))
    for field in fields(kind)
    if field.default is not MISSING
]


@pytest.mark.parametrize(("group", "name", "default"), OPTIONAL)
def test_a_row_without_the_column_gives_the_default(group: str, name: str, default: object) -> None:
    row = row_of(fleet_result(1))
    del row[name]
    assert getattr(getattr(estimate_of(row), group), name) == default
