"""Dialogues as ISO 14229-1 has them: every service, the order of its checks, sessions, security, silence."""

from dataclasses import replace

import pytest

from tests.support.uds.full_table import full_table
from tests.unit.ecu_emulator.diagnostics.bench import PARKED, Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_nothing_is_answered_with_nothing(bench: Bench) -> None:
    assert bench.ask("") == ""


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
    ("name", "value", "nrc"),
    [("vehicle_speed_m_s", 5.0, "88"), ("current_gear", 1.0, "8c"), ("clearing_possible", 0.0, "22")],
)
def test_what_was_learned_is_cleared_by_a_car_at_rest_alone(bench: Bench, name: str, value: float, nrc: str) -> None:
    bench.ask("10 03")
    assert bench.ask("31 01 03 03") == "7f 31 33"
    bench.unlock()
    bench.values[name] = value
    assert bench.ask("31 01 03 03") == f"7f 31 {nrc}"
    del bench.values[name]
    assert bench.ask("31 01 03 03") == f"7f 31 {nrc}"


def test_a_routine_that_the_vehicle_cannot_do_ends_with_a_refusal(bench: Bench) -> None:
    bench.unlock()
    assert bench.ask("31 01 03 03") == "7f 31 78"
    bench.fail(0x0303)
    assert bench.wait(0.1) == "7f 31 72"
    assert bench.ask("31 03 03 03") == "71 03 03 03 02"
    assert bench.ask("31 02 03 03") == "7f 31 12"
    assert bench.ask("31 01 03 03") == "7f 31 78"
    bench.finish(0x0303)
    assert bench.wait(0.1) == "71 01 03 03 00"
    bench.fail(0x0303)  # too late
    assert bench.ask("31 03 03 03") == "71 03 03 03 00"


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


def test_a_guest_does_not_keep_anothers_session_alive(bench: Bench) -> None:
    bench.ask("10 03")
    bench.wait(3.0)
    assert bench.ask("3e 00", client=1) == "7e 00"
    bench.wait(2.5)
    assert bench.ask("10 03", client=1) == "50 03 00 32 01 f4"
    assert bench.ask("10 03") == "7f 10 21"


def test_a_session_ends_with_the_connection_of_its_client(bench: Bench) -> None:
    bench.ask("10 03", client=7)
    bench.leave(8)
    assert bench.ask("22 f1 86", client=7) == "62 f1 86 03"
    bench.leave(7)
    assert bench.ask("10 03") == "50 03 00 32 01 f4"


def test_whoever_clears_codes_and_resets_does_so_for_all(bench: Bench) -> None:
    bench.ask("10 03")
    assert bench.ask("14 ff ff ff", client=1) == "54"
    assert bench.ask("11 01", client=1) == "51 01"
    bench.wait(1.0)
    assert bench.ask("22 f1 86") == "62 f1 86 01"


def test_nobody_waits_for_the_response_to_a_client_who_has_gone(bench: Bench) -> None:
    bench.unlock()
    assert bench.ask("31 01 03 01 04 04") == "7f 31 78"
    assert bench.ask("3e 00", client=1) == "7f 3e 21"
    bench.leave(0)
    assert bench.ask("3e 00", client=1) == "7e 00"


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


@pytest.mark.parametrize("date", ["26 02 28", "24 02 29", "00 02 29", "99 12 31", "26 04 30", "26 10 01"])
def test_a_date_is_written(bench: Bench, date: str) -> None:
    bench.unlock()
    assert bench.ask(f"2e 04 00 {date}") == "6e 04 00"
    assert bench.ask("22 04 00") == f"62 04 00 {date}"


NO_DATES = ("ff ff ff", "26 1a 01", "2a 01 01", "26 01 0f", "26 13 01", "26 00 01", "26 01 32", "26 02 29", "00 00 00")


@pytest.mark.parametrize("digits", NO_DATES)
def test_digits_that_are_no_date_are_not_written(bench: Bench, digits: str) -> None:
    bench.unlock()
    assert bench.ask(f"2e 04 00 {digits}") == "7f 2e 31"


def test_a_service_may_need_security() -> None:
    before = full_table()
    services = {0x85: replace(before.services[0x85], levels=(1,)), 0x28: replace(before.services[0x28], levels=(1,))}
    bench = Bench(table=replace(before, services={**before.services, **services}))
    bench.ask("10 03")
    assert [bench.ask(request) for request in ("85 02", "28 03 01")] == ["7f 85 33", "7f 28 33"]
    bench.unlock()
    assert [bench.ask(request) for request in ("85 02", "28 03 01")] == ["c5 02", "68 03"]


def test_a_routine_that_the_vehicle_never_ends_is_stopped(bench: Bench) -> None:
    bench.unlock()
    bench.ask("31 01 03 01 04 04")
    assert bench.wait(300.0) == "71 01 03 01 02"
