"""Dialogues as ISO 14229-1 has them: every service, the order of its checks, sessions, security, silence."""

import pytest

from tests.unit.ecu_emulator.diagnostics.bench import PARKED, Bench


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


@pytest.mark.parametrize(
    ("name", "value", "nrc"),
    [
        ("engine_speed_rad_s", 0.0, "84"),
        ("engine_speed_rad_s", 50.0, "82"),
        ("engine_speed_rad_s", 200.0, "81"),
        ("sump_temperature_k", 313.15, "87"),
        ("sump_temperature_k", 390.0, "86"),
        ("vehicle_speed_m_s", 5.0, "88"),
        ("pedal_ratio", 0.1, "8a"),
        ("current_gear", 1.0, "8c"),
        ("engine_run_time_s", 1.0, "85"),
        ("brake_pressure_pa", 0.0, "8f"),
        ("adaptation_possible", 0.0, "22"),
    ],
)
def test_the_adaptation_of_the_clutches_says_what_is_missing(bench: Bench, name: str, value: float, nrc: str) -> None:
    bench.ask("10 03")
    assert bench.ask("31 01 03 02") == "7f 31 33"
    bench.unlock()
    bench.values[name] = value
    assert bench.ask("31 01 03 02") == f"7f 31 {nrc}"
    bench.values |= PARKED
    assert bench.ask("31 01 03 02") == "7f 31 78"


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
        ("2f 02 06 03 70", "7f 2f 7f"),
    ],
)
def test_a_session_and_its_security_belong_to_the_client_who_entered_it(
    bench: Bench, request_: str, response: str
) -> None:
    bench.unlock()
    assert bench.ask(request_, client=1) == response
    assert bench.ask("22 f1 86") == "62 f1 86 03"
    assert bench.ask("2e f1 98 43 4c 55 54 43 48 53 48 4f 50") == "6e f1 98"


def test_a_client_leaves_the_data_that_another_one_made_alone(bench: Bench) -> None:
    assert bench.ask("2c 01 f3 00 f1 90 01 03", client=1) == "6c 01 f3 00"
    assert bench.ask("2c 01 f3 01 f1 90 01 01", client=2) == "6c 01 f3 01"
    assert bench.ask("2c 01 f3 00 f1 90 01 01", client=2) == "7f 2c 31"
    assert bench.ask("2c 03 f3 00", client=2) == "7f 2c 31"
    assert bench.ask("2c 03", client=2) == "6c 03"  # its own
    assert bench.ask("22 f3 01", client=2) == "7f 22 31"
    assert bench.ask("22 f3 00", client=1) == "62 f3 00 57 44 43"
    bench.leave(1)
    assert bench.ask("22 f3 00", client=2) == "7f 22 31"
