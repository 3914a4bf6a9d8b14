"""Service 2A: data that come again and again, at three rates, until they are stopped or the session ends."""

from dataclasses import replace

import pytest

from ecu_emulator.diagnostics.descriptions import Access, Coding, Datum, Field
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


def test_a_table_whose_periodic_data_fit_no_frame_is_refused() -> None:
    table = shipped_table()
    long = Field(name="x", kind=Coding.BYTES, size_bytes=8, source="x")
    datum = Datum(number=0xF2AA, name="long", fields=(long,), read=Access(sessions=(1,)))
    with pytest.raises(ConfigError, match="data long: what is sent periodically has at most 7 bytes"):
        replace(table, data={**table.data, datum.number: datum})
    with pytest.raises(ConfigError, match="service 0x2A is there, but not"):
        replace(table, periodic=None)
