"""Signals asked for on a bus: what is sent, and what happens with other testers and odd controllers."""

import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path

import can
import pytest

from canlog.errors import NOTICE
from canlog_tests.test_traffic import sent_bits
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.asked_signals import Overheard, flagged
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.profile import AskingRules, Profile, load_profile, load_shipped
from tests.integration.test_tester import vehicle
from tests.support.asked import batch_of
from tests.support.patience import HANG_S
from workshop.controller.controller import Controller
from workshop.controller.table import engine_table, table_like
from workshop.tester import signal_asking
from workshop.tester.addresses import CanAddress
from workshop.tester.can_line import line_on
from workshop.tester.signal_asking import SignalAsker

pytestmark = pytest.mark.asks

VALUES = {
    "engine_torque_nm": 120.0,
    "input1_speed_rad_s": 200.0,
    "input2_speed_rad_s": 150.0,
    "clutch1_pressure_pa": 4e5,
    "clutch2_pressure_pa": 0.0,
    "sump_temperature_k": 353.15,
    "engine_speed_rad_s": 210.0,
    "vehicle_speed_m_s": 10.0,
}
ALLOWED = {0x22, 0x01, 0x21, 0x3E}
NUMBERS = count()


def controller(values: Mapping[str, float] = VALUES, without: int | None = None) -> Controller:
    table = table_like("vw_dsg")
    table = replace(table, services={number: one for number, one in table.services.items() if number != without})
    return Controller(table, values=lambda: values, clock=time.monotonic, chance=secrets.token_bytes)


def engine(values: Mapping[str, float] = VALUES) -> Controller:
    """Return the engine's controller beside the transmission's."""
    return Controller(engine_table(), values=lambda: values, clock=time.monotonic, chance=secrets.token_bytes)


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

    def requests(self, request_id: int = 0x7E1) -> list[can.Message]:
        """Return the first frames of the requests on an identifier."""
        return [one for one in list(self.frames) if one.arbitration_id == request_id and one.data[0] >> 4 < 2]


@contextmanager
def asked(
    profile: Profile,
    channel: str,
    together: int = 8,
    *,
    listen_s: float = 0.05,
    define: bool = False,
    bitrate: int | None = None,
) -> Iterator[SignalAsker]:
    addresses = [CanAddress(request_id=one.request_id, response_id=one.reply_id) for one in profile.asked.values()]
    with can.Bus(channel, "virtual") as bus:
        asker = SignalAsker(
            profile.asked,
            AskingRules(together=together, define=define),
            lambda: line_on(bus, addresses, is_fd=False, listen_s=listen_s, goes_on=lambda: asker.goes_on),
            bitrate,
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
    by_load = {"no answer in time", "an answer to no request"}  # of a machine that was busy meanwhile
    assert reader.faults.keys() <= {"refused with 31", *by_load}  # to forget what was never defined


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
    profile, listen_s = load_shipped("dct_asked"), 1.0  # what the other pauses for is far less, on a busy machine too
    with heard(channel) as ear, vehicle(channel, controller()), asked(profile, channel, listen_s=listen_s) as asker:
        wait_for(lambda: asker.set_count >= 2)
        with can.Bus(channel, "virtual") as other:
            over = threading.Event()

            def ask() -> None:
                while not over.wait(0.01):
                    other.send(can.Message(arbitration_id=0x7E0, is_extended_id=False, data=b"\x02\x3e\x80"))

            thread = threading.Thread(target=ask)
            thread.start()
            try:
                wait_for(lambda: "another tester asks" in caplog.text)
                sent = asker.sent.total()
                time.sleep(1.5 * listen_s)
                assert asker.sent.total() == sent
                first_s = next(one.timestamp for one in list(ear.frames) if one.arbitration_id == 0x7E0)
                assert sum(one.timestamp > first_s for one in ear.requests()) <= 1
            finally:
                over.set()
                thread.join()
        wait_for(lambda: asker.sent.total() > sent)


@pytest.mark.parametrize(("bitrate", "is_long"), [(500_000, True), (250_000, False)])
def test_requests_and_answers_take_a_twentieth_of_the_bus(
    channel: str, tmp_path: Path, bitrate: int, *, is_long: bool
) -> None:
    path = tmp_path / "fast.toml"
    at = "18DA10F1" if is_long else "7E1"
    entry = '{{ did = 0x{}, at = "{}", unit = "bar" }}\n'
    path.write_text(
        f"[signals]\nclutch1_pressure_pa = {entry.format('38EB', at)}clutch2_pressure_pa = {entry.format('38EA', at)}",
        encoding="utf-8",
    )
    ids = (0x18DA10F1, 0x18DAF110) if is_long else (0x7E1, 0x7E9)
    with heard(channel) as ear, can.Bus(channel, "virtual") as near:
        answers = Canned(near, {"2238EB": ["05 62 38 EB 01 90"], "2238EA": ["05 62 38 EA 00 00"]}, ids)
        with (
            can.Notifier(near, [answers], timeout=0.05),
            asked(load_profile(path), channel, 1, bitrate=bitrate) as asker,
        ):
            wait_for(lambda: asker.set_count >= 40)
    own = [one for one in ear.frames if one.arbitration_id in ids]
    bits = sum(sent_bits(flagged(one.arbitration_id), bytes(one.data)) for one in own)
    assert bits / bitrate <= 0.05 * (own[-1].timestamp - own[0].timestamp + 0.05)


class Canned:
    """A controller that answers requests of one frame with frames that are told beforehand, some after a while."""

    def __init__(
        self, bus: can.BusABC, answers: Mapping[str, Sequence[str | float]], ids: tuple[int, int] = (0x7E1, 0x7E9)
    ) -> None:
        self.answers = dict(answers)
        self.begun_count = 0  # answers, each of which keeps to what ``answers`` told when it was begun
        self._bus, self._ids = bus, ids

    def __call__(self, message: can.Message) -> None:
        if message.arbitration_id != self._ids[0] or message.data[0] >> 4:
            return
        answer = self.answers.get(bytes(message.data[1 : 1 + message.data[0]]).hex().upper(), ())
        self.begun_count += 1
        for one in answer:
            if isinstance(one, float):
                time.sleep(one)
                continue
            data = bytes.fromhex(one).ljust(8, b"\0")
            self._bus.send(can.Message(arbitration_id=self._ids[1], is_extended_id=self._ids[1] > 0x7FF, data=data))


@contextmanager
def canned(channel: str, *answers: str | float) -> Iterator[Canned]:
    """Yield a controller that answers the request of `PRESSURE` so."""
    with can.Bus(channel, "virtual") as near:
        one = Canned(near, {"2238EB": answers})
        with can.Notifier(near, [one], timeout=0.05):
            yield one


def pressure_profile(folder: Path) -> Profile:
    path = folder / "one.toml"
    path.write_text('[signals]\nclutch1_pressure_pa = { did = 0x38EB, at = "7E1", unit = "bar" }\n', encoding="utf-8")
    return load_profile(path)


GOOD = "05 62 38 EB 01 90"


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("05 62 38 EA 01 90", "38EB at 7E1 is not told (an answer with other numbers than were asked for"),
        ("04 62 38 EB 01", "38EB at 7E1 is not told (an answer of another length than the profile says)"),
        ("06 62 38 EB 01 90 00", "38EB at 7E1 is not told (an answer with other numbers"),
        ("03 7F 22 22", "38EB at 7E1 is not told (conditions not correct (22)), and asked for again later"),
        ("03 7F 22", "is not told"),
        ("10 0A 62 38 EB 01 90 00", "began an answer and broke it off"),
        ("03 59 02 FF", "7E1 (answers 7E9) does not answer"),
        ("00", "7E1 (answers 7E9) does not answer"),
    ],
)
def test_odd_answers_are_told_in_words_give_no_sample_and_end(
    channel: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, answer: str, words: str
) -> None:
    caplog.set_level(NOTICE)
    profile = pressure_profile(tmp_path)
    with heard(channel) as ear, canned(channel, answer) as car, asked(profile, channel) as asker:
        wait_for(lambda: words in caplog.text)
        odd = list(ear.frames)
        assert asker.set_count == 0
        car.answers["2238EB"] = [GOOD]
        wait_for(lambda: asker.set_count >= 2)
    reader = Overheard(list(profile.asked.values()))
    for _ in [*reader.feed(batch_of(odd)), *reader.drain()]:
        pass
    assert not reader.answered


def test_patience_is_counted_and_told_once(channel: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(NOTICE)
    with canned(channel, "03 7F 22 78", GOOD), asked(pressure_profile(tmp_path), channel) as asker:
        wait_for(lambda: asker.set_count >= 3)
    assert caplog.text.count("asked for more time (78)") == 1
    assert "7E1 (answers 7E9) asked for more time (78)" in caplog.text


def samples_in(profile: Path, frames: Sequence[can.Message]) -> set[float]:
    """Return the clutch pressures [Pa] that a dialogue tells by the file of a profile."""
    decoder = interpret(None, profile).decoder()
    found = [*decoder.stream(batch_of(list(frames))), *decoder.drain()]
    told = [one.columns[Signal.CLUTCH1_PRESSURE] for one in found if Signal.CLUTCH1_PRESSURE in one.columns]
    return {value for series in told for value in series.value.tolist()}


def test_a_controller_that_dies_in_an_answer_and_starts_anew_gives_no_wrong_sample(
    channel: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(NOTICE)
    for name, value_s in {"AGAIN_S": 0.2, "FIRST_PAUSE_S": 0.05, "LONGEST_PAUSE_S": 0.2}.items():
        monkeypatch.setattr(signal_asking, name, value_s)
    profile = pressure_profile(tmp_path)
    with heard(channel) as ear, canned(channel, GOOD) as car, asked(profile, channel) as asker:
        wait_for(lambda: asker.set_count >= 3)
        car.answers["2238EB"] = ["10 0A 62 38 EB 01 90 00"]  # broken off
        seen = len(ear.requests())
        wait_for(lambda: len(ear.requests()) > seen + 1)
        car.answers.clear()  # it is dead
        wait_for(lambda: "does not answer; trying again" in caplog.text)
        car.answers["2238EB"] = ["03 7F 22 22"]  # it starts
        wait_for(lambda: "38EB at 7E1 is not told (conditions not correct (22))" in caplog.text)
        sets = asker.set_count
        car.answers["2238EB"] = [GOOD]
        wait_for(lambda: asker.set_count >= sets + 3)
    assert "asking goes on" in caplog.text
    assert ear.services() == {0x22}
    assert samples_in(tmp_path / "one.toml", ear.frames) == {0x190 * 1e5}


@pytest.mark.asks(may_define=True)
def test_a_log_that_begins_in_a_drive_hears_what_a_datum_is_made_of(
    channel: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal_asking, "DEFINE_AGAIN_S", 0.5)
    profile = load_shipped("dct_asked")
    with vehicle(channel, controller()), asked(profile, channel, define=True) as asker:
        wait_for(lambda: asker.set_count >= 5)
        with heard(channel) as ear:
            count = asker.set_count
            wait_for(lambda: asker.set_count >= count + 60)
    reader = Overheard(list(profile.asked.values()))
    for _ in [*reader.feed(batch_of(list(ear.frames))), *reader.drain()]:
        pass
    assert {one.number for one in reader.answered} >= {0x38EB, 0x38EA, 0x100C}


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
