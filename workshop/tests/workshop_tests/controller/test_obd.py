"""OBD, answer by answer as SAE J1979 and ISO 15765-4 have it."""

from collections.abc import Iterable

import pytest

from workshop.controller.memory import TestResult
from workshop.controller.server import cycled, warmed_up
from workshop.controller.table import shipped_table
from workshop_tests.controller.bench import Bench

PROBED_PIDS = sorted(set(range(0x100)) - set(range(0, 0x100, 0x20)))
DRIVEN = {
    "engine_speed_rad_s": 209.44, "vehicle_speed_m_s": 27.78, "coolant_temperature_k": 363.15,
    "engine_run_time_s": 70_000.0,
    "odometer_m": 12_345_678.0, "throttle_ratio": 1.0, "pedal_ratio": 0.5, "ambient_temperature_k": 293.15,
    "manifold_pressure_pa": 60e3, "engine_torque_nm": -25.0,
}  # fmt: skip


@pytest.fixture
def bench() -> Bench:
    bench = Bench(table=shipped_table())
    bench.values = {**bench.values, **DRIVEN}
    return bench


def there(bitmaps: Iterable[bytes]) -> set[int]:
    """Return the numbers that a chain of bitmaps names."""
    bits = "".join(f"{int.from_bytes(bitmap, 'big'):032b}" for bitmap in bitmaps)
    return {place for place, bit in enumerate(bits, start=1) if bit == "1"}


@pytest.mark.parametrize(
    ("pid", "answer"),
    [
        ("04", "97"),  # 60 kPa of 101.3
        ("05", "82"),
        ("0B", "3c"),
        ("0C", "1f 40"),  # 2000 rpm
        ("0D", "64"),
        ("11", "ff"),  # full throttle is all bits, not "not available"
        ("1C", "06"),
        ("1F", "ff ff"),  # stays at the highest value
        ("31", "30 3a"),
        ("46", "3c"),
        ("49", "80"),
        ("62", "73"),  # -10 %
        ("63", "00 fa"),
        ("A6", "00 01 e2 41"),
    ],
)
def test_a_parameter_is_what_the_vehicle_says(bench: Bench, pid: str, answer: str) -> None:
    assert bench.ask(f"01 {pid}") == f"41 {pid.lower()} {answer}"


@pytest.mark.parametrize("service", ["01", "06", "09"])
def test_bitmaps_name_exactly_what_is_answered(bench: Bench, service: str) -> None:
    bitmaps, first = [], 0
    while True:
        answer = bytes.fromhex(bench.ask(f"{service} {first:02x}", to_all=True))
        assert answer[:2] == bytes([int(service, 16) + 0x40, first])
        bitmaps.append(answer[2:])
        if not answer[-1] & 1:
            break
        first += 0x20
    answered = {number for number in PROBED_PIDS if bench.ask(f"{service} {number:02x}", to_all=True)}
    assert there(bitmaps) - set(range(0, 0x100, 0x20)) == answered


@pytest.mark.parametrize(
    ("request_hex", "to_this_one"),
    [
        ("01", "7f 01 12"),
        ("01 02", "7f 01 12"),
        ("01 C0", "7f 01 12"),  # nothing is there any more
        ("01 0C 0D 05 11 46 04 01", "7f 01 12"),  # seven
        ("02 0C", "7f 02 12"),
        ("02 0C 00", "7f 02 12"),  # no freeze frame
        ("02 02 01", "7f 02 12"),  # there is but one
        ("03 00", "7f 03 12"),
        ("04 00", "7f 04 12"),
        ("09 02 04", "7f 09 12"),
        ("09 03", "7f 09 12"),
        ("06", "7f 06 12"),
        ("06 01", "7f 06 12"),
        ("06 E1 E2", "7f 06 12"),
        ("05 01", "7f 05 11"),
        ("08 01", "7f 08 11"),
    ],
)
def test_what_is_not_there_is_silence_to_a_request_to_all(bench: Bench, request_hex: str, to_this_one: str) -> None:
    assert bench.ask(request_hex, to_all=True) == ""
    assert bench.ask(request_hex) == to_this_one


def fail(bench: Bench, code: str) -> None:
    bench.monitor(code, TestResult.FAILED)


def good_cycle(bench: Bench, code: str) -> None:
    bench.monitor(code, TestResult.PASSED)
    bench.state = warmed_up(bench.state)
    bench.state = cycled(bench.table, bench.state)


def test_a_code_is_pending_then_confirmed_with_lamp_and_permanent(bench: Bench) -> None:
    fail(bench, "P0711")
    said = [bench.ask(service) for service in ("03", "07", "0A", "01 01")]
    assert said == ["43 00", "47 01 07 11", "4a 00", "41 01 00 04 00 00"]
    bench.state = cycled(bench.table, bench.state)
    fail(bench, "P0711")
    said = [bench.ask(service) for service in ("03", "07", "0A", "01 01")]
    assert said == ["43 01 07 11", "47 01 07 11", "4a 01 07 11", "41 01 81 04 00 00"]


def test_the_freeze_frame_is_of_the_first_code_until_that_is_forgotten(bench: Bench) -> None:
    assert bench.ask("02 02 00") == "42 02 00 00 00"
    fail(bench, "P0711")
    bench.values["vehicle_speed_m_s"] = 10.0
    fail(bench, "P0218")
    assert bench.ask("02 02 00 0D 00 0C 00") == "42 02 00 07 11 0d 00 64 0c 00 1f 40"
    frozen = there([bytes.fromhex(bench.ask("02 00 00"))[3:]])
    assert frozen == {0x02, 0x04, 0x05, 0x0B, 0x0C, 0x0D, 0x11, 0x1F, 0x20}
    bench.state = cycled(bench.table, bench.state)
    good_cycle(bench, "P0711")  # pending goes, and with it what was kept
    assert bench.ask("02 02 00") == "42 02 00 00 00"
    bench.values["vehicle_speed_m_s"] = 0.0
    assert bench.ask("04") == "44"
    assert bench.ask("02 0D 00", to_all=True) == ""


def test_a_client_clears_codes_at_standstill_but_not_those_that_are_permanent(bench: Bench) -> None:
    fail(bench, "P0218")  # confirmed at once
    fail(bench, "P0780")
    assert bench.ask("04", to_all=True) == "7f 04 22"  # the vehicle drives
    assert bench.ask("03") == "43 01 02 18"
    bench.values["vehicle_speed_m_s"] = 0.0
    assert bench.ask("04", to_all=True) == "44"
    assert [bench.ask(service) for service in ("03", "07", "0A")] == ["43 00", "47 00", "4a 01 02 18"]
    assert bench.ask("19 02 2F") == "59 02 ff"  # as 14 FFFFFF: all codes, whatever they light
    bench.state = cycled(bench.table, bench.state)
    assert bench.ask("0A") == "4a 01 02 18"  # nothing was tested
    good_cycle(bench, "P0218")
    assert bench.ask("0A") == "4a 00"
