"""``UdsTester``, ``scan_controllers`` and ``diagnose(poll=...)``: what the commands find, as Python values."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

import diag_service
import workshop
from tests.integration.test_tester import MASK, Vehicle, slipping, told, vehicle
from tests.support.in_process import ended, never_a_program
from tests.support.patience import HANG_S
from workshop.tester.commands import data_record, routine_record
from workshop.tester.polling import ControllerReport
from workshop.tester.trouble import trouble_record

CHANNEL = "python tester"
BUS = ("-i", "virtual", "-c", CHANNEL, "--listen", "0.05", "--timeout", "20", "--active")


@pytest.fixture(scope="module")
def car() -> Iterator[Vehicle]:
    with vehicle(CHANNEL, slipping()) as car:
        yield car


@pytest.fixture(name="bus")
def _bus(car: Vehicle) -> Iterator[can.BusABC]:
    del car
    with can.Bus(CHANNEL, "virtual") as bus:
        yield bus


@pytest.fixture(autouse=True)
def _as_a_library() -> Iterator[None]:
    with never_a_program():
        yield


def asker(bus: can.BusABC, **more: Any) -> workshop.UdsTester:  # noqa: ANN401 - arguments of the tester
    return workshop.UdsTester(bus, is_active=True, listen_s=0.05, timeout_s=HANG_S, **more)


def test_answers_are_those_of_the_commands(bus: can.BusABC, capfd: pytest.CaptureFixture[str]) -> None:
    asked = "F190", "fluid temperature", "0999"
    with asker(bus) as tester:
        codes = tester.trouble_codes()
        data = tester.data(0xF190, *asked[1:])
        (in_session,) = tester.data("F200", session=0x03)
        with pytest.raises(diag_service.RefusedError, match="security access denied") as refused:
            tester.routine(0x0305, "start")
        started = tester.routine("0305", "start", unlock=(1, bytes.fromhex(MASK)))
        assert (tester.controller, tester.description) == ("7E1 (answers 7E9)", "TCU")
        assert (tester.counts.refusals, tester.counts.silent) == (2, 0)
    assert tester.traffic is not None
    assert refused.value.code == 0x33
    assert in_session.values is not None
    assert capfd.readouterr() == ("", "")
    assert [trouble_record(code) for code in codes] == told("dtc", *BUS)["codes"]
    assert [data_record(one) for one in data] == ended("did", *asked, *BUS, "--json").records[0]["data"]
    assert routine_record(started) == told("routine", "0305", "start", "--unlock", f"1={MASK}", *BUS)["routine"]


def test_nothing_is_sent_unless_it_may_be(car: Vehicle, bus: can.BusABC) -> None:
    car.heard.clear()
    with workshop.UdsTester(bus, listen_s=0.6) as tester:
        assert tester.traffic is not None
        assert tester.traffic.frame_count > 0
        with pytest.raises(
            diag_service.ConfigError, match=r"nothing was sent; .* be asked: 19 02 AF: the codes; 19 04"
        ):
            tester.trouble_codes()
        with pytest.raises(diag_service.ConfigError, match="be asked: 10 03; 27 01 and the key; 31 01: 0302"):
            tester.routine("0302", "start", unlock=(1, b"\x01"))
        with pytest.raises(
            diag_service.ConfigError, match="the codes; 10 03; 14: P0811: clear; 19 02 08: what is left"
        ):
            tester.clear_trouble_codes("p0811", mask=0x08, session=0x03)
    with pytest.raises(diag_service.ConfigError, match="be asked: 3E 00 to 7E0-7E7; each that answers: 3E 00"):
        workshop.scan_controllers(bus, first=0x7E0, last=0x7E7)
    with pytest.raises(diag_service.ConfigError, match="use it in a with block"):
        workshop.UdsTester(bus, is_active=True).trouble_codes()
    assert car.heard == []


async def test_codes_are_asked_for_while_the_bus_is_diagnosed(car: Vehicle, tmp_path: Path) -> None:
    store = tmp_path / "car.sqlite"
    async with diag_service.diagnose(
        interface="virtual", channel=CHANNEL, store=store, poll=diag_service.Poll(period_s=1.0)
    ) as live:
        async with asyncio.timeout(HANG_S):
            while not live.controller_reports:  # noqa: ASYNC110 - it offers no event
                await asyncio.sleep(0.01)
        assert live.frames.on_bus > 0
    first = live.controller_reports[0]
    assert isinstance(first, ControllerReport)
    assert [code.code for code in first.codes] == ["P0811"]
