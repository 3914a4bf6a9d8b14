"""Service 2A: data that come again and again, at three rates, until they are stopped or the session ends."""

from dataclasses import replace

import pytest

from ecu_emulator.diagnostics.descriptions import Access, Coding, Datum, Field
from ecu_emulator.diagnostics.table import Periodic
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.errors import ConfigError
from tests.unit.ecu_emulator.diagnostics.bench import Bench

ENGINE_85_RAD_S = "0c af"  # 811.7 rpm in quarters


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    assert made.ask("10 03").startswith("50")
    return made


@pytest.mark.parametrize(("mode", "count"), [("01", 1), ("02", 5), ("03", 20)])
def test_data_come_at_the_rate_that_was_asked_for(bench: Bench, mode: str, count: int) -> None:
    assert bench.ask(f"2a {mode} 00") == "6a"
    sent = bench.sent(0.98)
    assert sent == [f"00 {ENGINE_85_RAD_S} 00 00 00 ff"] * count
    bench.values["engine_speed_rad_s"] = 0.0
    assert set(bench.sent(1.0)) == {"00 00 00 00 00 00 ff"}


def test_several_data_each_have_a_message_and_a_new_rate_replaces_the_old(bench: Bench) -> None:
    assert bench.ask("2a 03 00 01 01") == "6a"
    assert bench.ask("2a 01 01") == "6a"
    numbers = [message[:2] for message in bench.sent(0.98)]
    assert (numbers.count("00"), numbers.count("01")) == (20, 1)


def test_one_is_stopped_or_all(bench: Bench) -> None:
    bench.ask("2a 03 00 01 02")
    assert bench.ask("2a 04 00") == "6a"
    assert {message[:2] for message in bench.sent(0.2)} == {"01", "02"}
    assert bench.ask("2a 04") == "6a"
    assert bench.sent(2.0) == []
    assert bench.ask("2a 04 00") == "6a"  # what does not run is stopped already


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("2a", "7f 2a 13"),
        ("2a 01", "7f 2a 13"),
        ("2a 05 00", "7f 2a 31"),
        ("2a 83 00", "7f 2a 31"),  # there is no sub-function, so no bit to suppress a response
        ("2a 03 77", "7f 2a 31"),
        ("2a 04 77", "7f 2a 31"),
        ("2a 03 77 00", "6a"),  # what is not there is left out
        ("2a 03 00 03", "7f 2a 33"),
    ],
)
def test_what_cannot_be_sent_is_refused(bench: Bench, request_: str, response: str) -> None:
    assert bench.ask(request_) == response
    assert bool(bench.sent(0.1)) == (response == "6a")


def test_the_default_session_sends_nothing() -> None:
    assert Bench().ask("2a 03 00") == "7f 2a 7f"


@pytest.mark.parametrize("ending", ["10 01", "11 03"])
def test_it_ends_with_the_session(bench: Bench, ending: str) -> None:
    bench.ask("2a 03 00")
    assert bench.sent(0.5)
    bench.ask(ending)
    assert bench.sent(1.0) == []
    bench.ask("10 03")
    assert bench.sent(1.0) == []


def test_what_is_sent_does_not_keep_the_session_alive(bench: Bench) -> None:
    bench.ask("2a 03 00")
    assert len(bench.sent(20.0)) == pytest.approx(5 * 20, abs=1)  # S3 is five seconds


def test_it_goes_on_in_another_session_but_not_what_was_unlocked(bench: Bench) -> None:
    bench.unlock()
    bench.ask("2a 03 00 03")
    assert {message[:2] for message in bench.sent(0.2)} == {"00", "03"}
    bench.ask("10 03")
    assert {message[:2] for message in bench.sent(0.2)} == {"00"}


def test_there_is_a_limit_of_how_many_at_once(bench: Bench) -> None:
    for low in range(0x10, 0x19):
        assert bench.ask(f"2c 01 f2 {low:02x} 01 02 01 01") == f"6c 01 f2 {low:02x}"
    assert bench.ask("2a 03 10 11 12 13 14 15 16 17 18") == "7f 2a 31"
    assert bench.sent(0.1) == []
    assert bench.ask("2a 03 10 11 12 13 14 15 16 17") == "6a"
    assert bench.ask("2a 03 18") == "7f 2a 31"
    assert bench.ask("2a 01 10") == "6a"
    assert len(bench.sent(0.03)) == 8


def test_what_a_client_defined_is_sent_while_it_fits_a_frame(bench: Bench) -> None:
    assert bench.ask("2c 01 f2 10 01 05 01 02 01 02 01 02") == "6c 01 f2 10"
    bench.ask("2a 02 10")
    assert bench.sent(0.1) == [f"10 {ENGINE_85_RAD_S} 00 00"]
    assert bench.ask("22 f2 10") == f"62 f2 10 {ENGINE_85_RAD_S} 00 00"
    bench.ask("2c 01 f2 10 01 00 01 04")  # eight bytes by now
    assert bench.sent(1.0) == []
    assert bench.ask("2a 02 10") == "7f 2a 31"


def test_what_is_forgotten_is_sent_no_more(bench: Bench) -> None:
    bench.ask("2c 01 f2 10 01 05 01 02")
    bench.ask("2a 03 10")
    assert bench.sent(0.1)
    assert bench.ask("2c 03 f2 10") == "6c 03 f2 10"
    assert bench.sent(1.0) == []


def test_what_the_table_has_cannot_be_defined_anew(bench: Bench) -> None:
    assert bench.ask("2c 01 f2 00 01 05 01 02") == "7f 2c 31"
    assert bench.ask("2c 03 f2 00") == "7f 2c 31"


def test_what_was_missed_is_not_made_up_for(bench: Bench) -> None:
    bench.ask("2a 03 00")
    bench.sent(0.1)
    bench.wait(3.0)
    assert len(bench.sent(0.5)) == pytest.approx(10, abs=1)


def test_a_table_whose_periodic_data_fit_no_frame_is_refused() -> None:
    table = shipped_table()
    long = Field(name="x", kind=Coding.BYTES, size_bytes=8, source="x")
    datum = Datum(number=0xF2AA, name="long", fields=(long,), read=Access(sessions=(1,)))
    with pytest.raises(ConfigError, match="data long: what is sent periodically has at most 7 bytes"):
        replace(table, data={**table.data, datum.number: datum})
    with pytest.raises(ConfigError, match="service 0x2A is there, but not"):
        replace(table, periodic=None)


@pytest.mark.parametrize("wrong", [{"fast_s": 0.001}, {"fast_s": 0.5}, {"slow_s": 9999.0}, {"most": 0}])
def test_rates_that_cannot_be_kept_are_refused(wrong: dict[str, float]) -> None:
    right = {"response_id": 0x5E9, "slow_s": 1.0, "medium_s": 0.2, "fast_s": 0.05, "most": 8}
    with pytest.raises(ConfigError):
        Periodic(**{**right, **wrong})  # type: ignore[arg-type]  # numbers of both kinds
