"""Dialogues as ISO 14229-1 has them: every service, the order of its checks, sessions, security, silence."""

import pytest

from workshop_tests.controller.bench import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_session_ends_after_s3(bench: Bench) -> None:
    bench.ask("10 03")
    bench.wait(4.9)
    assert bench.ask("3e 80") == ""
    bench.wait(4.9)
    assert bench.ask("22 f1 86") == "62 f1 86 03"
    bench.wait(5.0)
    assert bench.ask("22 f1 86") == "62 f1 86 01"


def test_guessing_is_punished_for_ten_seconds(bench: Bench) -> None:
    bench.ask("10 03")
    for nrc in ("35", "35", "36"):
        bench.ask("27 01")
        assert bench.ask("27 02 00 00 00 00") == f"7f 27 {nrc}"
    assert bench.ask("27 01") == "7f 27 37"
    for _ in range(3):
        bench.wait(3.3)
        bench.ask("3e 80")
    assert bench.ask("27 01") == "7f 27 37"
    bench.wait(0.2)
    assert bench.ask("27 01").startswith("67")
    assert bench.ask("27 02 00 00 00 00") == "7f 27 36"  # one more, not three


def test_a_reset_takes_a_moment_in_which_nothing_is_heard(bench: Bench) -> None:
    bench.ask("10 03")
    assert bench.ask("11 03") == "51 03"
    assert bench.ask("3e 00") == ""
    bench.wait(0.3)
    assert bench.ask("22 f1 86") == "62 f1 86 01"


def test_a_routine_that_is_awaited_is_answered_when_it_has_ended(bench: Bench) -> None:
    bench.unlock()
    assert bench.ask("31 81 03 01 04 04") == "7f 31 78"
    assert bench.ask("22 f1 86") == "7f 22 21"
    assert bench.ask("3e 80", to_all=True) == ""
    assert bench.wait(3.4) == ""
    assert bench.wait(0.1) == "7f 31 78"  # before P2* is over
    assert bench.wait(1.0) == ""
    bench.finish(0x0301)
    assert bench.wait(0.01) == "71 01 03 01 00"  # although it was not wanted: 78 was sent
    assert bench.ask("22 f1 86") == "62 f1 86 03"  # S3 stood still


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("22 f1 86", "62 f1 86 01"),  # as in the default session
        ("22 03 10", "7f 22 31"),
        ("19 02 08", "59 02 ff"),
        ("3e 00", "7e 00"),
        ("10 01", "50 01 00 32 01 f4"),
        ("10 03", "7f 10 21"),
        ("10 40", "7f 10 7e"),
        ("27 01", "7f 27 7f"),
        ("2e f1 98 43 4c 55 54 43 48 53 48 4f 50", "7f 2e 7f"),
    ],
)
def test_a_session_and_its_security_belong_to_the_client_who_entered_it(
    bench: Bench, request_: str, response: str
) -> None:
    bench.unlock()
    assert bench.ask(request_, client=1) == response
    assert bench.ask("22 f1 86") == "62 f1 86 03"
    assert bench.ask("2e f1 98 43 4c 55 54 43 48 53 48 4f 50") == "6e f1 98"
