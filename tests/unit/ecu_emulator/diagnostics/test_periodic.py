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


def test_what_is_sent_does_not_keep_the_session_alive(bench: Bench) -> None:
    bench.ask("2a 03 00")
    assert len(bench.sent(20.0)) == pytest.approx(5 * 20, abs=1)  # S3 is five seconds


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


def test_there_is_a_limit_of_how_many_at_once(bench: Bench) -> None:
    for low in range(0x10, 0x19):
        assert bench.ask(f"2c 01 f2 {low:02x} 01 02 01 01") == f"6c 01 f2 {low:02x}"
    assert bench.ask("2a 03 10 11 12 13 14 15 16 17 18") == "7f 2a 31"
    assert bench.sent(0.1) == []
    assert bench.ask("2a 03 10 11 12 13 14 15 16 17") == "6a"
    assert bench.ask("2a 03 18") == "7f 2a 31"
    assert bench.ask("2a 01 10") == "6a"
    assert len(bench.sent(0.03)) == 8
