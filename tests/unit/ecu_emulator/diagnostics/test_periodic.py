"""Service 2A: data that come again and again, at three rates, until they are stopped or the session ends."""

import pytest

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
