"""Dialogues as ISO 14229-1 has them: every service, the order of its checks, sessions, security, silence."""

from dataclasses import replace

import pytest

from ecu_emulator.diagnostics.memory import TestResult
from tests.support.uds.full_table import full_table
from tests.unit.ecu_emulator.diagnostics.bench import PARKED, Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("10 03", "50 03 00 32 01 f4"),  # P2 50 ms, P2* 5,000 ms in steps of 10
        ("10 01", "50 01 00 32 01 f4"),
        ("10", "7f 10 13"),
        ("10 02", "7f 10 12"),
        ("10 02 00", "7f 10 12"),  # the sub-function is looked at before the whole length
        ("10 40", "7f 10 7e"),  # there is such a session, but not from here
        ("10 03 00", "7f 10 13"),
        ("11 01", "51 01"),
        ("11 04", "7f 11 12"),
        ("14 ff ff ff", "54"),
        ("14 ff ff", "7f 14 13"),
        ("14 12 34 56", "7f 14 31"),
        ("19 01 ff", "59 01 ff 00 00 19"),
        ("19 01", "7f 19 13"),
        ("19 05 ff", "7f 19 12"),
        ("19 02 08", "59 02 ff"),
        ("19 03", "59 03"),
        ("19 04 08 11 07 ff", "59 04 08 11 07 50"),  # known, nothing stored
        ("19 04 08 11 07 00", "7f 19 31"),
        ("19 04 08 11 08 ff", "7f 19 31"),
        ("19 06 08 11 07 04", "7f 19 31"),
        ("19 06 08 11 07 fe", "7f 19 31"),  # no regulated records
        ("19 14", "59 14"),
        ("22 f1 86", "62 f1 86 01"),
        ("22 f1 95 f1 86", "62 f1 95 00 01 f1 86 01"),
        ("22 12 34", "7f 22 31"),
        ("22 12 34 f1 86", "62 f1 86 01"),  # what is not there is left out
        ("22 f1", "7f 22 13"),
        ("22", "7f 22 13"),
        ("22 " + "f1 86 " * 16, "62 " + " ".join(["f1 86 01"] * 16)),
        ("22 " + "f1 86 " * 17, "7f 22 13"),
        ("22 03 10", "7f 22 31"),  # readable in other sessions only
        ("27 01", "7f 27 7f"),
        ("28 00 01", "7f 28 7f"),
        ("2e f1 98 00", "7f 2e 7f"),
        ("31 01 03 03", "7f 31 7f"),
        ("3e 00", "7e 00"),
        ("3e 01", "7f 3e 12"),
        ("3e 00 00", "7f 3e 13"),
        ("85 02", "7f 85 7f"),
        ("84 02", "7f 84 11"),
        ("50 03", "7f 50 11"),
        ("7f", "7f 7f 11"),
    ],
)
def test_a_controller_that_was_just_started_answers(bench: Bench, request_: str, response: str) -> None:
    assert bench.ask(request_) == response


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("22 03 10", "7f 22 33"),
        ("27 01", "67 01 01 02 03 04"),
        ("27 01 00", "7f 27 13"),
        ("27 02 00 00 00 00", "7f 27 24"),  # no seed yet
        ("27 02 00", "7f 27 13"),
        ("27 03", "7f 27 7e"),
        ("27 05", "7f 27 12"),
        ("27 00", "7f 27 12"),
        ("28 03 01", "68 03"),
        ("28 04 01", "7f 28 12"),
        ("28 03", "7f 28 13"),
        ("28 03 00", "7f 28 31"),
        ("28 03 21", "7f 28 31"),  # a network that is not here
        ("28 00 f3", "68 00"),
        ("2e f1 98 30", "7f 2e 13"),  # length before security
        ("2e f1 98 " + "30" * 10, "7f 2e 33"),
        ("2e f1 86 03", "7f 2e 31"),
        ("2e f1 98", "7f 2e 13"),
        ("2f 02 06 03 70", "7f 2f 33"),
        ("2f 01 00 03 70", "7f 2f 31"),
        ("31 01 03 01 04 04", "7f 31 33"),
        ("31 01 03", "7f 31 13"),
        ("31 04 03", "7f 31 12"),
        ("31 01 09 99", "7f 31 31"),
        ("85 02", "c5 02"),
        ("85 02 ff ff ff", "c5 02"),
        ("85 02 00 00 00", "7f 85 31"),
        ("85 02 ff", "7f 85 13"),
        ("85 03", "7f 85 12"),
        ("10 40", "50 40 00 32 01 f4"),
    ],
)
def test_the_extended_session_answers(bench: Bench, request_: str, response: str) -> None:
    bench.ask("10 03")
    assert bench.ask(request_) == response


@pytest.mark.parametrize("request_", ["10 83", "3e 80", "11 81", "19 82 ff", "10 81"])
def test_a_positive_response_that_is_not_wanted_is_not_sent(bench: Bench, request_: str) -> None:
    assert bench.ask(request_) == ""


def test_the_session_changes_without_a_response_too(bench: Bench) -> None:
    bench.ask("10 83")
    assert bench.ask("22 f1 86") == "62 f1 86 03"


@pytest.mark.parametrize("request_", ["10 ff", "3e 81", "19 82"])
def test_a_negative_response_is_sent_whatever_was_wanted(bench: Bench, request_: str) -> None:
    assert bench.ask(request_).startswith("7f")


@pytest.mark.parametrize("request_", ["84 00", "3e 01", "22 12 34", "10 40", "27 01"])
def test_a_request_to_all_that_is_not_for_this_controller_is_passed_over(bench: Bench, request_: str) -> None:
    assert bench.ask(request_, to_all=True) == ""
    assert bench.ask(request_).startswith("7f")


@pytest.mark.parametrize(("request_", "response"), [("22 f1", "7f 22 13"), ("3e 00", "7e 00"), ("14 ff", "7f 14 13")])
def test_a_request_to_all_is_answered_otherwise(bench: Bench, request_: str, response: str) -> None:
    assert bench.ask(request_, to_all=True) == response


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


def test_the_default_session_ends_what_belonged_to_the_other(bench: Bench) -> None:
    bench.unlock()
    bench.ask("28 03 03")
    bench.ask("85 02")
    bench.ask("2f 02 06 03 70")
    bench.ask("31 01 03 05")
    bench.wait(5.0)
    state = bench.state
    assert (state.session, state.unlocked, state.are_codes_updated, dict(state.controlled)) == (1, 0, True, {})
    assert state.communication.sends_normal
    assert not state.routines[0x0305].is_running


def test_another_session_locks_and_keeps_the_rest(bench: Bench) -> None:
    bench.unlock()
    bench.ask("28 01 01")
    bench.ask("85 02")
    bench.ask("2f 02 06 03 70")
    assert bench.ask("10 03").startswith("50")
    assert bench.ask("2f 02 06 00") == "7f 2f 33"
    assert not bench.state.are_codes_updated
    assert not bench.state.communication.sends_normal
    assert not bench.state.controlled  # it needed security


def test_a_key_opens_and_a_second_seed_is_zero(bench: Bench) -> None:
    bench.unlock()
    assert bench.ask("27 01") == "67 01 00 00 00 00"
    assert bench.ask("27 02 00 00 00 00") == "7f 27 24"


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


def test_a_wrong_key_needs_a_new_seed(bench: Bench) -> None:
    bench.ask("10 03")
    bench.ask("27 01")
    bench.ask("27 02 00 00 00 00")
    assert bench.ask("27 02 5b a7 c0 38") == "7f 27 24"  # the right one for the seed before


def test_a_reset_does_not_end_the_punishment(bench: Bench) -> None:
    bench.ask("10 03")
    for _ in range(3):
        bench.ask("27 01")
        bench.ask("27 02 00 00 00 00")
    bench.ask("11 01")
    bench.wait(1.0)
    bench.ask("10 03")
    assert bench.ask("27 01") == "7f 27 37"


def test_a_reset_takes_a_moment_in_which_nothing_is_heard(bench: Bench) -> None:
    bench.ask("10 03")
    assert bench.ask("11 03") == "51 03"
    assert bench.ask("3e 00") == ""
    bench.wait(0.3)
    assert bench.ask("22 f1 86") == "62 f1 86 01"


def test_nobody_resets_a_car_that_drives(bench: Bench) -> None:
    bench.values["vehicle_speed_m_s"] = 3.0
    assert bench.ask("11 01") == "7f 11 88"
    del bench.values["vehicle_speed_m_s"]
    assert bench.ask("11 01") == "7f 11 88"  # nor one of which it is not known


def test_what_is_written_is_read(bench: Bench) -> None:
    bench.unlock()
    assert bench.ask("2e f1 98 " + "37" * 10) == "6e f1 98"
    assert bench.ask("22 f1 98") == "62 f1 98 " + " ".join(["37"] * 10)
    assert bench.ask("2e f1 98 " + "2a" * 10) == "7f 2e 31"  # asterisks
    assert bench.ask("2e 04 01 ff ff") == "7f 2e 31"  # 65,535 km
    assert bench.ask("2e 04 01 27 10") == "6e 04 01"
    assert bench.ask("2e f1 90 " + "41" * 17) == "7f 2e 31"  # the maker's, in the maker's session


def test_the_maker_writes_the_vin(bench: Bench) -> None:
    bench.unlock(3)
    assert bench.ask("2e f1 90 " + b"WDCTEMUL3TED0OOPS".hex()) == "7f 2e 31"  # a VIN has no O
    assert bench.ask("2e f1 90 " + b"WDCTEMUL5TED00048".hex()) == "6e f1 90"
    assert bench.ask("22 f1 90") == "62 f1 90 " + b"WDCTEMUL5TED00048".hex(" ")


def test_data_are_scaled_and_know_what_is_not_known(bench: Bench) -> None:
    bench.values |= {"clutch1_slip_rad_s": -10.0, "engine_speed_rad_s": 1e9}
    assert bench.ask("22 02 00") == "62 02 00 fe 82 80 00"  # -95.5 rpm in quarters; not known
    assert bench.ask("22 01 05") == "62 01 05 ff fe"  # as much as can be said
    assert bench.ask("22 02 06") == "62 02 06 78"  # 80 degC


def test_a_value_under_control_is_what_the_tester_says(bench: Bench) -> None:
    bench.unlock()
    assert bench.ask("2f 02 06 03 50") == "6f 02 06 03 50"
    bench.values["sump_temperature_k"] = 300.0
    assert bench.ask("22 02 06") == "62 02 06 50"
    assert bench.ask("2f 02 06 00") == "6f 02 06 00 43"
    assert bench.ask("2f 02 06 02") == "6f 02 06 02 43"
    bench.values["sump_temperature_k"] = 350.0
    assert bench.ask("22 02 06") == "62 02 06 43"
    assert bench.ask("2f 02 06 01") == "7f 2f 31"
    assert bench.ask("2f 02 06 03") == "7f 2f 13"


def test_a_controller_believes_the_value_that_a_tester_put_in_place_of_its_own(bench: Bench) -> None:
    bench.unlock()
    bench.ask("2f 02 06 03 10")  # -24 degC
    assert bench.ask("31 01 03 01 04 04") == "7f 31 87"
    bench.ask("2f 02 06 03 ff")  # not available
    assert bench.ask("31 01 03 01 04 04") == "7f 31 86"
    bench.ask("2f 02 06 00")
    assert bench.ask("31 01 03 01 04 04") == "7f 31 78"


def test_a_client_makes_data_of_its_own(bench: Bench) -> None:
    assert bench.ask("2c 01 f3 00 f1 86 01 01 01 03 02 01") == "6c 01 f3 00"
    bench.values["target_gear"] = 4.0
    assert bench.ask("22 f3 00") == "62 f3 00 01 04"
    assert bench.ask("2c 01 f3 00 02 06 01 01") == "6c 01 f3 00"
    assert bench.ask("22 f3 00") == "62 f3 00 01 04 78"
    assert bench.ask("2c 01 f2 00 f1 86 01 01") == "7f 2c 31"
    assert bench.ask("2c 01 f3 01 f1 86 02 01") == "7f 2c 31"  # past its end
    assert bench.ask("2c 01 f3 01" + " f1 86 01 01" * 62) == "7f 2c 31"  # more than may be
    assert bench.ask("2c 03 f3 00") == "6c 03 f3 00"
    assert bench.ask("22 f3 00") == "7f 22 31"


def test_a_routine_is_started_asked_and_stopped(bench: Bench) -> None:
    bench.unlock()
    assert bench.ask("31 03 03 05") == "7f 31 24"
    assert bench.ask("31 01 03 05") == "71 01 03 05 01"
    assert bench.ask("31 01 03 05") == "7f 31 24"
    assert bench.ask("31 03 03 05") == "71 03 03 05 01"
    assert bench.ask("31 02 03 05") == "71 02 03 05 02"
    assert bench.ask("31 02 03 05") == "7f 31 24"
    assert bench.ask("31 01 03 04") == "71 01 03 04 01"
    assert bench.ask("31 02 03 04") == "7f 31 12"
    bench.wait(0.5)
    assert bench.ask("31 03 03 04") == "71 03 03 04 00"


@pytest.mark.parametrize(
    ("name", "value", "nrc"),
    [
        ("engine_speed_rad_s", 0.0, "84"),
        ("engine_speed_rad_s", 50.0, "82"),
        ("engine_speed_rad_s", 200.0, "81"),
        ("sump_temperature_k", 280.0, "87"),
        ("sump_temperature_k", 390.0, "86"),
        ("vehicle_speed_m_s", 5.0, "88"),
        ("pedal_ratio", 0.1, "8a"),
        ("current_gear", 1.0, "8c"),
        ("engine_run_time_s", 1.0, "85"),
        ("brake_pressure_pa", 0.0, "8f"),
        ("revs_possible", 0.0, "22"),
    ],
)
def test_the_routine_of_the_workshop_says_what_is_missing(bench: Bench, name: str, value: float, nrc: str) -> None:
    bench.unlock()
    bench.values[name] = value
    assert bench.ask("31 01 03 01 04 04") == f"7f 31 {nrc}"


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


def test_a_routine_that_the_vehicle_never_ends_is_stopped(bench: Bench) -> None:
    bench.unlock()
    bench.ask("31 01 03 01 04 04")
    assert bench.wait(300.0) == "71 01 03 01 02"


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


def test_codes_stay_as_they_are_while_their_setting_is_off(bench: Bench) -> None:
    bench.ask("10 03")
    bench.ask("85 02")
    bench.monitor("P2787", TestResult.FAILED)
    assert bench.ask("19 02 ff").split()[-1] == "50"
    assert "27 87 4b 50" in bench.ask("19 02 ff")
    bench.ask("85 01")
    bench.monitor("P2787", TestResult.FAILED)
    assert "27 87 4b af" in bench.ask("19 02 ff")


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
