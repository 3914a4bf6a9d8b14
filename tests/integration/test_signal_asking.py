"""Signals asked for on a bus: what is sent, and what happens with other testers and odd controllers."""

import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path

import can
import pytest

from canlog.notice import NOTICE
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.asked_signals import Overheard
from diag_service.mapping.profile import AskingRules, Profile, load_profile, load_shipped
from diag_service.tester import signal_asking
from diag_service.tester.addresses import CanAddress
from diag_service.tester.signal_asking import Plan, SignalAsker, line_on
from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.table_file import personalities, table_like
from ecu_emulator.errors import ConfigError
from tests.integration.test_tester import vehicle
from tests.support.asked import batch_of
from tests.support.in_process import ended
from tests.support.patience import HANG_S

pytestmark = pytest.mark.asks

VALUES = {
    "engine_torque_nm": 120.0,
    "input1_speed_rad_s": 200.0,
    "input2_speed_rad_s": 150.0,
    "clutch1_pressure_pa": 4e5,
    "clutch2_pressure_pa": 0.0,
    "sump_temperature_k": 353.15,
}
ALLOWED = {0x22, 0x01, 0x21, 0x3E}
NUMBERS = count()


def controller(values: Mapping[str, float] = VALUES, without: int | None = None) -> Controller:
    table = table_like("vw_dsg")
    table = replace(table, services={number: one for number, one in table.services.items() if number != without})
    return Controller(table, values=lambda: values, clock=time.monotonic, chance=secrets.token_bytes)


class Ear:
    """Keeps what is said on a bus."""

    def __init__(self) -> None:
        self.frames: list[can.Message] = []

    def __call__(self, message: can.Message) -> None:
        self.frames.append(message)

    def services(self, request_id: int = 0x7E1) -> set[int]:
        """Return the services of the requests on an identifier."""
        own = [bytes(one.data) for one in list(self.frames) if one.arbitration_id == request_id]
        single = {data[1] for data in own if data[0] >> 4 == 0}
        return single | {data[2] for data in own if data[0] >> 4 == 1}


@contextmanager
def asked(
    profile: Profile, channel: str, *, together: int = 8, listen_s: float = 0.05, define: bool = False
) -> Iterator[SignalAsker]:
    addresses = [CanAddress(request_id=one.request_id, response_id=one.reply_id) for one in profile.asked.values()]
    with can.Bus(channel, "virtual") as bus:
        asker = SignalAsker(
            profile.asked,
            AskingRules(together=together, define=define),
            lambda: line_on(bus, addresses, is_fd=False, listen_s=listen_s, goes_on=lambda: asker.goes_on),
        )
        with asker:
            yield asker


def wait_for(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


@pytest.fixture(name="channel")
def _channel() -> str:
    return f"signals {next(NUMBERS)}"


@contextmanager
def heard(channel: str) -> Iterator[Ear]:
    ear = Ear()
    with can.Bus(channel, "virtual") as bus, can.Notifier(bus, [ear], timeout=0.05):
        yield ear


def test_only_reading_services_are_sent_whatever_happens(channel: str) -> None:
    with heard(channel) as ear, vehicle(channel, controller()), asked(load_shipped("dct_asked"), channel) as asker:
        wait_for(lambda: asker.set_count >= 5)
    assert ear.services() <= ALLOWED
    assert set(asker.sent) == {0x22}


@pytest.mark.asks(may_define=True)
def test_where_the_profile_allows_it_a_round_is_one_datum_that_the_controller_was_told_to_make(channel: str) -> None:
    profile, car = load_shipped("dct_asked"), controller()
    with heard(channel) as ear, vehicle(channel, car), asked(profile, channel, define=True) as asker:
        wait_for(lambda: asker.set_count >= 5)
        assert [str(one) for one in asker.plan.fast] == ["F300 at 7E1"]
        assert set(asker.sent) == {0x22, 0x2C}
        car.ask(bytes.fromhex("2C03F300"))  # as a reset does
        count = asker.set_count
        wait_for(lambda: asker.sent[0x2C] == 4 and asker.set_count > count + 5)
    assert ear.services() == {0x22, 0x2C}
    reader = Overheard(list(profile.asked.values()))
    for _ in [*reader.feed(batch_of(ear.frames)), *reader.drain()]:
        pass
    assert reader.answered.keys() == {one.data_id for one in profile.asked.values()}
    assert reader.faults.keys() <= {"refused with 31"}  # to forget what was never defined


@pytest.mark.asks(may_define=True)
def test_a_controller_that_makes_no_data_is_asked_for_each(channel: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(NOTICE)
    with (
        vehicle(channel, controller(without=0x2C)),
        asked(load_shipped("dct_asked"), channel, define=True) as asker,
    ):
        wait_for(lambda: asker.set_count >= 3)
        assert len(asker.plan.fast[0].data) == 5
    assert "7E1 makes no datum of others: service not supported (11)" in caplog.text


@pytest.mark.parametrize("together", [1, 8])
def test_what_is_refused_or_has_another_length_is_left_out_and_the_rest_goes_on(
    channel: str, tmp_path: Path, together: int
) -> None:
    path = tmp_path / "more.toml"
    path.write_text(
        '[signals]\nclutch1_pressure_pa = { did = 0x38EB, at = "7E1", unit = "bar" }\n'
        'clutch2_pressure_pa = { did = 0xABCD, at = "7E1", unit = "bar" }\n'
        'sump_temperature_k = { did = 0x2104, at = "7E1", size = 4, unit = "degC" }\n',
        encoding="utf-8",
    )
    with vehicle(channel, controller()), asked(load_profile(path), channel, together=together) as asker:
        wait_for(lambda: asker.set_count >= 3 and len(asker.plan.refused) >= 2)
    assert {str(one) for one in asker.plan.refused} == {"ABCD at 7E1", "2104 at 7E1"}


def test_another_tester_makes_it_silent_until_that_one_is_gone(channel: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(NOTICE)
    with vehicle(channel, controller()), asked(load_shipped("dct_asked"), channel) as asker:
        wait_for(lambda: asker.set_count >= 2)
        with can.Bus(channel, "virtual") as other:
            over = threading.Event()

            def ask() -> None:
                while not over.wait(0.01):
                    other.send(can.Message(arbitration_id=0x7E0, is_extended_id=False, data=b"\x02\x3e\x80"))

            thread = threading.Thread(target=ask)
            thread.start()
            wait_for(lambda: "another tester asks" in caplog.text)
            sent = asker.sent.total()
            time.sleep(0.3)
            assert asker.sent.total() == sent
            over.set()
            thread.join()
        wait_for(lambda: asker.sent.total() > sent)


class Pending:
    """A controller that asks for patience, twice or for ever, before it tells a pressure."""

    def __init__(self, bus: can.BusABC, count: int) -> None:
        self._bus, self._left = bus, count

    def __call__(self, message: can.Message) -> None:
        if message.arbitration_id == 0x7E1 and message.data[1] == 0x22:
            while self._left:
                self._left -= 1
                self._say("03 7F 22 78")
                time.sleep(0.15)
            self._say("05 62 38 EB 01 90")

    def _say(self, text: str) -> None:
        self._bus.send(can.Message(arbitration_id=0x7E9, is_extended_id=False, data=bytes.fromhex(text)))


@pytest.mark.parametrize("most_s", [30.0, 0.2])
def test_a_controller_that_asks_for_patience_is_waited_for_but_tells_no_sample_late(
    channel: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_s: float
) -> None:
    monkeypatch.setattr(signal_asking, "MOST_PENDING_S", most_s)
    path = tmp_path / "one.toml"
    path.write_text('[signals]\nclutch1_pressure_pa = { did = 0x38EB, at = "7E1", unit = "bar" }\n', encoding="utf-8")
    profile = load_profile(path)
    with (
        heard(channel) as ear,
        can.Bus(channel, "virtual") as near,
        can.Notifier(near, [Pending(near, 3)], timeout=0.05),
        asked(profile, channel) as asker,
    ):
        wait_for(lambda: asker.set_count >= 3)
    reader = Overheard(list(profile.asked.values()))
    for _ in [*reader.feed(batch_of(ear.frames)), *reader.drain()]:
        pass
    assert reader.faults["no answer in time"] >= (most_s > 1.0)  # who gives up asks anew, and that is answered
    assert reader.answered.total() >= 2


def test_a_controller_that_comes_back_is_asked_again(channel: str, caplog: pytest.LogCaptureFixture) -> None:
    with asked(load_shipped("dct_asked"), channel) as asker:
        wait_for(lambda: "asking is interrupted" in caplog.text)
        with vehicle(channel, controller()):
            wait_for(lambda: asker.set_count >= 1)


def test_a_controller_that_is_silent_keeps_no_other_from_being_asked(
    channel: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "two.toml"
    path.write_text(
        '[signals]\nclutch1_pressure_pa = { did = 0x38EB, at = "7E1", unit = "bar" }\n'
        'vehicle_speed_m_s = { pid = 0x0D, at = "7E0", length = 8, unit = "km/h" }\n',
        encoding="utf-8",
    )
    with vehicle(channel, controller()), asked(load_profile(path), channel) as asker:
        wait_for(lambda: asker.set_count >= 3)
    assert "7E0 (answers 7E8) does not answer: it is asked now and then" in caplog.text


def test_temperatures_are_asked_for_rarely() -> None:
    profile = load_shipped("dct_asked")
    plan = Plan(profile.asked, AskingRules(together=3))
    assert [len(one.data) for one in plan.fast] == [3, 2]
    rounds = [len(plan.due(0.02 * number)) for number in range(100)]
    assert sum(number == 3 for number in rounds) == 4 + 2
    assert profile.sources[Signal.CLUTCH1_PRESSURE].place == "38EB at 7E1"


def test_a_personality_answers_with_its_own_data() -> None:
    assert personalities() == ("bmw_dkg", "vw_dsg")
    assert controller().ask(bytes.fromhex("2238EB100C")) == bytes.fromhex("6238EB0190100C0960")
    with pytest.raises(ConfigError, match="nobody answers like audi: there are bmw_dkg, vw_dsg"):
        table_like("audi")


def test_asking_for_signals_and_for_codes_at_once_is_refused(tmp_path: Path, channel: str) -> None:
    words = (
        "run",
        "-i",
        "virtual",
        "-c",
        channel,
        "--profile",
        "dct_asked",
        "--active",
        "--store",
        tmp_path / "s.sqlite",
    )
    run = ended(*words, "--poll", "5")
    assert run.status == 2
    assert "error: --poll: this profile asks all the time already" in run.err
