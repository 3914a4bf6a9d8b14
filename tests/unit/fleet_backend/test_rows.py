"""What is kept of a message in a row."""

import json
from hashlib import blake2b

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet_backend.rows import CONTENT, Poison, content_digest, quarantine_row, shift_row
from fleet_backend.schema import FRICTION_COLUMNS
from tests.golden import FOLDER as GOLDEN
from tests.support.fleet import NOW, fleet_result, row_of

ROW = row_of(fleet_result())


@given(st.binary(max_size=200), st.text(max_size=50))
def test_whatever_came_is_kept_in_printable_text(payload: bytes, detail: str) -> None:
    poison = Poison(topic=f"x/{detail}", vehicle=None, payload=payload, reason="malformed", detail=detail)
    row = quarantine_row(poison, NOW)
    for name in ("topic", "detail", "head"):
        text = str(row[name])
        assert text.isprintable()
        assert text.encode().decode() == text
    assert row["size_bytes"] == len(payload)


@pytest.mark.parametrize(("name", "known"), [("shift", -3664896956469182395), ("shift-rejected", -5958550621060343079)])
def test_the_digest_of_a_content_is_for_ever(name: str, known: int) -> None:
    data = json.loads((GOLDEN / "v1" / f"{name}.json").read_text(encoding="utf-8"))["data"]
    assert shift_row(data)["content_digest"] == known


@settings(max_examples=40)
@given(st.lists(st.floats() | st.floats(1e-5, 1e-3) | st.sampled_from([0.0, -0.0, 1e-4, 1e16]), min_size=8, max_size=8))
def test_a_digest_is_made_of_what_python_writes_for_numbers(numbers: list[float]) -> None:
    row = ROW | dict(zip(FRICTION_COLUMNS, numbers, strict=False))
    told = repr(tuple(row[name] for name in CONTENT)).encode()
    assert content_digest(row) == int.from_bytes(blake2b(told, digest_size=8).digest(), signed=True)
