"""Which subjects of NATS a stream takes."""

import pytest

from fleet_link.jetstream import covers


@pytest.mark.parametrize(
    ("pattern", "is_covered"),
    [
        ("clutchdiag.v1.*.bundle", True),
        ("clutchdiag.v1.*.*", True),
        ("clutchdiag.>", True),
        (">", True),
        ("clutchdiag.v1.*.shift", False),
        ("clutchdiag.v1.car1.bundle", False),
        ("clutchdiag.v1.*", False),
        ("clutchdiag.v1.*.bundle.*", False),
        ("clutchdiag.v1.*.bundle.>", False),
    ],
)
def test_a_stream_takes_what_its_subjects_cover(pattern: str, *, is_covered: bool) -> None:
    assert covers(pattern, "clutchdiag.v1.*.bundle") is is_covered
