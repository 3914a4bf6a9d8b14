"""``UdsTester``, ``scan_controllers`` and ``diagnose(poll=...)``: what the commands find, as Python values."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can
import pytest

import canlog
import diag_service
import ecu_emulator
from diag_service.tester.commands import data_record, routine_record
from diag_service.tester.polling import ControllerReport
from diag_service.tester.trouble import trouble_record
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.memory import TestResult as Result
from tests.integration.test_tester import MASK, SLIPS, Vehicle, another_tester, failing_car, told, vehicle
from tests.support.doip.desk import framed
from tests.support.in_process import ended, never_a_program
from tests.support.patience import HANG_S
from tests.support.uds.wire import parked_controller

if TYPE_CHECKING:
    from can.typechecking import CanFilter

CHANNEL = "python tester"
BUS = ("-i", "virtual", "-c", CHANNEL, "--listen", "0.05", "--timeout", "20", "--active")


@pytest.fixture(scope="module")
def controller() -> Controller:
    controller = parked_controller()
    for _ in range(20):
        controller.report(SLIPS, Result.FAILED)
    return controller


@pytest.fixture(scope="module")
def car(controller: Controller) -> Iterator[Vehicle]:
    with vehicle(CHANNEL, controller) as car:
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


def asker(bus: can.BusABC, **more: Any) -> diag_service.UdsTester:  # noqa: ANN401 - arguments of the tester
    return diag_service.UdsTester(bus, is_active=True, listen_s=0.05, timeout_s=HANG_S, **more)


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


def test_codes_are_cleared_and_nobody_is_asked_before() -> None:
    with failing_car("python clears"), can.Bus("python clears", "virtual") as bus, asker(bus) as tester:
        with pytest.raises(diag_service.ConfigError, match=r"P2787 is not among .* reports: P0811, P0218"):
            tester.clear_trouble_codes("P2787")
        with pytest.raises(diag_service.RefusedError, match="request out of range"):
            tester.clear_trouble_codes(0x123456)
        one = tester.clear_trouble_codes("p0811")
        assert (one.groups, [code.code for code in one.gone]) == ((SLIPS,), ["P0811"])
        assert tester.trouble_codes(has_details=False) == one.after != ()
        rest = tester.clear_trouble_codes(session=0x03)
        assert (rest.before, rest.groups, rest.after) == (one.after, (0xFFFFFF,), ())


def test_nothing_is_sent_unless_it_may_be(car: Vehicle, bus: can.BusABC) -> None:
    car.heard.clear()
    with diag_service.UdsTester(bus, listen_s=0.6) as tester:
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
        diag_service.scan_controllers(bus, first=0x7E0, last=0x7E7)
    with pytest.raises(diag_service.ConfigError, match="use it in a with block"):
        diag_service.UdsTester(bus, is_active=True).trouble_codes()
    assert car.heard == []


def test_another_tester_is_heard_on_a_bus_that_was_handed_over_with_filters(car: Vehicle, bus: can.BusABC) -> None:
    filters: list[CanFilter] = [{"can_id": 0x7E9, "can_mask": 0x7FF, "extended": False}]
    bus.set_filters(filters)
    with another_tester(CHANNEL, 0x7E0):
        tester = diag_service.UdsTester(bus, is_active=True, listen_s=0.6)
        with pytest.raises(diag_service.ControllerError, match="another tester is asking"), tester:
            pass
    assert bus.filters == filters
    assert len(car.heard) > 0


def test_a_bus_is_lent(bus: can.BusABC, car: Vehicle) -> None:
    with can.Bus(CHANNEL, "virtual") as other:  # long ago, when nobody listened
        other.send(can.Message(arbitration_id=0x7E0, is_extended_id=False, data=b"\x02\x3e\x00"))
    with asker(bus) as tester:
        assert len(tester.data("F190")) == 1
    with pytest.raises(diag_service.ConfigError, match="use it in a with block"):
        tester.data("F190")
    assert bus.filters is None
    filters: list[CanFilter] = [{"can_id": 0x0A0, "can_mask": 0x7FF, "extended": False}]
    bus.set_filters(filters)
    with tester:
        assert len(tester.data("F190")) == 1
    assert bus.filters == filters
    message = bus.recv(HANG_S)
    assert message is not None
    assert message.arbitration_id == 0x0A0


@contextmanager
def slow_node(*steps: bytes | float) -> Iterator[int]:
    """Run a node on the port that is returned: it takes a question, sends the steps or waits [s], and hangs up."""

    def serve() -> None:
        listener.accept()[0].close()  # this one only looks
        with suppress(OSError), listener, listener.accept()[0] as line:
            line.recv(100)
            line.sendall(framed(0x0006, "0E001011 10 00000000"))
            line.recv(100)
            line.sendall(framed(0x8002, "10110E00 00"))
            for step in steps:
                time.sleep(step) if isinstance(step, float) else line.sendall(step)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            thread.join()


@pytest.mark.parametrize("before", [(), (framed(0x8001, "10110E00 7F2278"), framed(0x0007))], ids=["late", "pending"])
def test_an_answer_over_ip_that_takes_its_time_is_not_lost(
    before: tuple[bytes, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    answer = framed(0x8001, "10110E00 621234 414243")
    with slow_node(*before, 0.4, answer[:9], 0.2, answer[9:]) as port:
        place: dict[str, Any] = {"doip": f"127.0.0.1:{port}", "ecu": 0x1011, "description": "dct"}
        with diag_service.UdsTester(**place, is_active=True, timeout_s=HANG_S) as tester:
            assert tester.data(0x1234)[0].data == b"ABC"
            with pytest.raises(diag_service.ControllerError, match=r"the node has closed the connection|Broken|reset"):
                tester.data(0x1234)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"channel": "x", "interface": "virtual"}, "either an open bus or an interface"),
        ({"doip": "127.0.0.1"}, "either an open bus or an interface"),
        ({"doip_authority": "ca.crt"}, "doip_authority needs doip"),
        ({"reply": 0x7E9}, "reply and address need ecu"),
        ({"ecu": 0x7E1, "address": 0x100}, "address must be 0 to FF"),
        ({"ecu": 0x7E1, "reply": 0x7E1}, "cannot have the same identifier"),
        ({"ecu": 1 << 29}, "--reply is needed|must be 0"),
        ({"listen_s": float("nan")}, "listen_s must be 0 to 3600 s, got nan"),
        ({"timeout_s": 0.0}, "timeout_s must be 0.001"),
        ({"description": "nothing"}, "no controller nothing"),
    ],
)
def test_what_cannot_be_is_told(bus: can.BusABC, options: dict[str, Any], text: str) -> None:
    with pytest.raises(diag_service.ConfigError, match=text):
        diag_service.UdsTester(bus, **options)


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


def test_a_bus_that_was_handed_over_is_polled_by_another_end(bus: can.BusABC) -> None:
    with pytest.raises(diag_service.ConfigError, match=r"give Poll\(bus=...\) a connection"):
        diag_service.diagnose(bus, poll=diag_service.Poll())
    with pytest.raises(diag_service.ConfigError, match="--poll must be at least 1 s"):
        diag_service.diagnose(interface="virtual", channel=CHANNEL, poll=diag_service.Poll(period_s=0.5))
    with can.Bus(CHANNEL, "virtual") as other:
        poll = diag_service.Poll(period_s=1.0, bus=other, description="dct", ecu=0x7E1)
        with diag_service.diagnose(bus, poll=poll).in_background() as heard:
            until_s = time.monotonic() + HANG_S
            while not heard.controller_reports and time.monotonic() < until_s:
                time.sleep(0.01)
        assert [report.record["controller"] for report in heard.controller_reports] == ["7E1 (answers 7E9)"]


def test_a_pdx_is_the_one_of_the_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made, own = tmp_path / "made.pdx", tmp_path / "own.pdx"
    assert ecu_emulator.write_pdx(made) == made.stat().st_size
    assert capsys.readouterr() == ("", "")
    from ecu_emulator.cli import main  # noqa: PLC0415 - after it was seen that the function says nothing

    assert main(["pdx", "-o", str(own)]) == 0
    assert made.read_bytes() == own.read_bytes()
    table = tmp_path / "table.toml"
    table.write_text("name = 3\n", encoding="utf-8")
    with pytest.raises(ecu_emulator.ConfigError, match=r"table\.toml"):
        ecu_emulator.write_pdx(made, table)
    with pytest.raises(ecu_emulator.ConfigError, match="cannot both be"):
        ecu_emulator.write_pdx(table, table)
    with pytest.raises(ecu_emulator.RecordError, match="cannot write"):
        ecu_emulator.write_pdx(tmp_path / "none" / "a.pdx")


def test_tables_of_every_format_are_those_of_the_command(drive_log: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.log"
    short.write_bytes(b"".join(drive_log.read_bytes().splitlines(keepends=True)[:500]))
    tables: dict[str, dict[str, Any]] = {".csv": {"values": "both"}, ".jsonl": {"values": "texts"}, ".arrows": {}}
    for suffix, words in tables.items():
        made, own = tmp_path / f"made{suffix}", tmp_path / f"own{suffix}"
        assert diag_service.decode(short, made, choice=canlog.TableChoice(**words)) == []
        options = [text for name, word in words.items() for text in (f"--{name.replace('shape', 'layout')}", word)]
        assert ended("decode", short, "-o", own, *options).status == 0
        assert made.read_bytes() == own.read_bytes()
    assert diag_service.decode([short], tmp_path / "data", choice=canlog.TableChoice(table_format="csv")) == []
    assert ended("decode", short, "-o", tmp_path / "own", "--format", "csv").status == 0
    written, own_tables = (
        {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()} for folder in ("data", "own")
    )
    assert written == own_tables
    assert len(written) > 1
    with pytest.raises(diag_service.OutputError, match=r"signals are written as \.parquet"):
        diag_service.decode(short, tmp_path / "made.txt")
