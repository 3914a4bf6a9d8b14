"""What is kept of a message in a row."""

from hypothesis import given
from hypothesis import strategies as st

from fleet_backend.rows import Poison, quarantine_row
from tests.fleet import NOW, fleet_result, row_of


@given(st.binary(max_size=200), st.text(max_size=50))
def test_whatever_came_is_kept_in_printable_text(payload: bytes, detail: str) -> None:
    poison = Poison(topic=f"x/{detail}", vehicle=None, payload=payload, reason="malformed", detail=detail)
    row = quarantine_row(poison, NOW)
    for name in ("topic", "detail", "head"):
        text = str(row[name])
        assert text.isprintable()
        assert text.encode().decode() == text
    assert row["size_bytes"] == len(payload)


def test_the_digest_of_the_content_tells_results_apart_and_nothing_else() -> None:
    one, same, other = row_of(fleet_result(1)), row_of(fleet_result(1)), row_of(fleet_result(2))
    assert one["content_digest"] == same["content_digest"] != other["content_digest"]
    assert -(2**63) <= int(str(one["content_digest"])) < 2**63
