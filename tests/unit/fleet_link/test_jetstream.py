"""Topics of MQTT as subjects of NATS."""

import pytest

from fleet_link.jetstream import covers, subject_of


@pytest.mark.parametrize(
    ("filter_text", "subject"),
    [
        ("$share/ingest/clutchdiag/v1/+/bundle", "clutchdiag.v1.*.bundle"),
        ("clutchdiag/v1/+/status", "clutchdiag.v1.*.status"),
    ],
)
def test_a_subscription_is_a_subject(filter_text: str, subject: str) -> None:
    assert subject_of(filter_text) == subject


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
