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


def test_the_kind_of_an_event_is_kept_beside_what_the_digest_is_made_of() -> None:
    row = row_of(fleet_result())
    record = json.loads((GOLDEN / "v1" / "shift.json").read_bytes())["data"]
    launch = shift_row({**record, "kind": "launch", "end_reason": "complete"})
    earlier = shift_row({key: value for key, value in record.items() if key not in {"kind", "end_reason"}})
    assert (launch["kind"], launch["end_reason"]) == ("launch", "complete")
    assert (earlier["kind"], earlier["end_reason"]) == (None, None)
    assert launch["content_digest"] == earlier["content_digest"]
    assert row["kind"] == "shift"


def test_what_a_prognosis_needs_is_kept_beside_what_the_digest_is_made_of() -> None:
    record = json.loads((GOLDEN / "v1" / "shift.json").read_bytes())["data"]
    trust = {"score": 0.75, "parts": {"frames": 1.0, "time": 0.75}}
    row = shift_row({**record, "trust": trust})
    older = shift_row({key: value for key, value in record.items() if key not in {"scale_free", "trust"}})
    assert {f"scale_free_{name}": value for name, value in record["scale_free"].items()}.items() <= row.items()
    assert (row["trust"], json.loads(str(row["trust_parts"]))) == (0.75, trust["parts"])
    assert {older[name] for name in ("scale_free_mu_c", "scale_free_correlation", "trust", "trust_parts")} == {None}
    assert row["content_digest"] == older["content_digest"]
