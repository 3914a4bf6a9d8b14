"""Faults at run time: the control socket's answers, and that a fault asked for happens."""

import json
import math
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import can
import pytest

from dbc.contract import load_contract
from ecu_emulator.bus.sender import transmit
from ecu_emulator.cli import main
from ecu_emulator.drive.orders import LiveOrders
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.live import PROMPT, ControlSocket, SentTruth
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.faults import (
    BusFault,
    BusFaultKind,
    CauseKind,
    Degradation,
    Fault,
    SensorFault,
    SensorFaultKind,
)
from ecu_emulator.scenario.scenario_file import load_scenario
from ecu_emulator.truth import EventTruth, ShiftTruth, TripTruth
from tests.support.builders import drive_scenario
from tests.support.patience import HANG_S


class Taken(list[object]):
    """Takes orders and does nothing."""

    def add_fault(self, fault: Fault) -> None:
        self.append(fault)

    def switch_engine(self, *, is_on: bool) -> None:
        self.append(is_on)

    def end_trip(self) -> None:
        self.append("end")

    def request_gear(self, gear: int) -> None:
        self.append(gear)


@pytest.fixture
def taken() -> Taken:
    return Taken()


@pytest.fixture
def path(tmp_path: Path, taken: Taken) -> Iterator[Path]:
    where = tmp_path / "control"
    with ControlSocket(where, taken, {"P0841": [{"quantity": "clutch1_pressure_pa", "kind": "not_available"}]}):
        yield where
    assert not where.exists()


def answers(path: Path, *lines: str) -> list[str]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.settimeout(HANG_S)
        caller.connect(str(path))
        caller.sendall("".join(f"{line}\n" for line in lines).encode())
        caller.shutdown(socket.SHUT_WR)
        with caller.makefile(encoding="utf-8") as stream:
            return stream.read().splitlines()


def test_faults_are_taken_by_the_keys_of_a_scenario(path: Path, taken: Taken) -> None:
    loss = {"kind": "loss", "share": 0.5, "duration_s": 2}
    offset = {"quantity": "engine_torque_nm", "kind": "offset", "size": 20}
    assert answers(path, json.dumps(loss), json.dumps(offset)) == [
        "ok: loss of the bus, 0.5, for 2 s",
        "ok: offset of engine_torque_nm, 20, from now on",
    ]
    assert taken == [
        BusFault(kind=BusFaultKind.LOSS, share=0.5, duration_s=2.0),
        SensorFault(quantity="engine_torque_nm", kind=SensorFaultKind.OFFSET, size=20.0),
    ]


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("loss", "error: not JSON"),
        ("[" * 4000, "error: not JSON"),
        ("[]", "error: a fault must be a table"),
        ("{}", "error: kind is missing"),
        ('{"kind": "los"}', "error: kind must be one of loss"),
        ('{"kind": "loss", "share": 2}', "error: share must be"),
        ('{"kind": "loss", "share": NaN}', "error: share must be"),
        ('{"quantity": "mood_k", "kind": "frozen"}', "error: quantity 'mood_k' has no sensor"),
        ("\xff", "error: "),
        ('{"engine": []}', "error: engine must be on or off"),
        ('{"trip": "begin"}', "error: trip must be end"),
        ('{"gear": "third"}', "error: gear must be a number"),
        ('{"code": "P9999"}', "error: no fault is known that leads to P9999; to these: P0841"),
        ('{"engine": "off", "kind": "loss"}', "error: engine is unknown"),
        ('{"kind": "glazed_lining", "clutch": 3}', "error: clutch of glazed-lining must be 0..2"),
    ],
)
def test_a_line_that_cannot_be_used_says_why_and_the_next_one_counts(
    path: Path, taken: Taken, line: str, answer: str
) -> None:
    first, second = answers(path, line, '{"kind": "silence"}')
    assert first.startswith(answer)
    assert second.startswith("ok: silence")
    assert len(taken) == 1


@pytest.mark.parametrize(
    ("words", "answer", "order"),
    [
        (
            ["fault", "glazed_lining", "--clutch", "1", "--strength", "1.5"],
            "glazed-lining of clutch 1, strength 1.5, from now on",
            Degradation(kind=CauseKind.GLAZED_LINING, clutch=1, strength=1.5),
        ),
        (
            ["code", "P0841"],
            "P0841 by not_available of clutch1_pressure_pa, 0, from now on",
            SensorFault(quantity="clutch1_pressure_pa", kind=SensorFaultKind.NOT_AVAILABLE),
        ),
        (["engine", "off"], "engine off", False),
        (["trip", "end"], "this trip ends, the next one follows", "end"),
        (["gear", "4"], "gear 4 is asked for", 4),
    ],
)
def test_an_operator_gives_orders_by_a_command(
    path: Path, taken: Taken, capsys: pytest.CaptureFixture[str], words: list[str], answer: str, order: object
) -> None:
    assert main(["control", str(path), *words]) == 0
    assert capsys.readouterr().out == f"{answer}\n"
    assert taken == [order]


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (["fault", "loss", "--share", "2"], 2, "share must be above 0"),
        (["engine", "off", "--share", "2"], 2, "share: of a fault, not of engine"),
        (["gear", "third"], 2, "gear must be a number, got 'third'"),
    ],
)
def test_an_order_that_is_not_taken_says_why(
    path: Path, taken: Taken, capsys: pytest.CaptureFixture[str], words: list[str], status: int, text: str
) -> None:
    assert main(["control", str(path), *words]) == status
    assert text in capsys.readouterr().err
    assert taken == []


def test_an_order_to_nobody_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["control", str(tmp_path / "nobody"), "trip", "end"]) == 4
    assert "no emulator listens at" in capsys.readouterr().err


def test_only_the_owner_may_connect(path: Path) -> None:
    assert path.stat().st_mode & 0o077 == 0


def test_a_drive_takes_faults_while_it_runs() -> None:
    drive = Drive(drive_scenario(seed=41))
    stretches = drive.stretches(2.0)
    next(stretches)
    asked = threading.Thread(
        target=drive.add_fault, args=(BusFault(kind=BusFaultKind.BAD_CRC, message="TCU_Shift", duration_s=0.5),)
    )
    asked.start()
    asked.join()
    drive.add_fault(
        SensorFault(quantity="hub_speed_rad_s", kind=SensorFaultKind.OFFSET, size=3.0, start_s=1.0, duration_s=0.1)
    )
    with pytest.raises(EmulatorConfigError, match="not on the bus"):
        drive.add_fault(BusFault(kind=BusFaultKind.LOSS, message="Radio"))
    foreign = SensorFault(quantity="turbine_speed_rad_s", kind=SensorFaultKind.FROZEN)
    with pytest.raises(EmulatorConfigError, match="'turbine_speed_rad_s' is not on the bus; known: "):
        drive.add_fault(foreign)
    with pytest.raises(EmulatorConfigError, match="is not on the bus"):
        Drive(replace(drive_scenario(), sensor_faults=(foreign,)))
    next(stretches)
    offset, crc = drive.totals.faults
    assert (crc.what, crc.count) == ("TCU_Shift", 50)
    assert crc.t_start_s == pytest.approx(2.0, abs=0.01)
    assert (offset.what, offset.count) == ("hub_speed_rad_s", 10)
    assert offset.t_start_s == pytest.approx(3.0, abs=0.01)


class AskingBus:
    """A bus on which an order is given as a frame of a certain time goes out, by the thread that sends it."""

    def __init__(self, order: Callable[[], None], at_s: float, stop: threading.Event) -> None:
        self._order, self._at_s, self._stop = order, at_s, stop
        self.sent: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        self.sent.append(message)
        if self._at_s < message.timestamp - self.sent[0].timestamp:
            self._order()
            self._at_s = math.inf
        if message.timestamp - self.sent[0].timestamp > 1.0:
            self._stop.set()


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (BusFault(kind=BusFaultKind.BAD_CRC, message="TCU_Shift"), "TCU_Shift"),
        (SensorFault(quantity="hub_speed_rad_s", kind=SensorFaultKind.OFFSET, size=30.0), "TCU_InputSpeeds"),
    ],
)
def test_a_fault_is_on_the_bus_within_a_tenth_of_a_second_of_the_drive(fault: Fault, message: str) -> None:
    sound, _ = frames_of(drive_scenario(seed=41))
    stop = threading.Event()
    sent = SentTruth(Drive(drive_scenario(seed=41)), None, pace=PROMPT)
    bus = AskingBus(lambda: sent.orders.add_fault(fault), 0.5, stop)
    transmit(bus, sent.frames(stop), stop, ahead=sent.pace.stretches_ahead)
    can_id = load_contract("nominal").get_message_by_name(message).frame_id
    begin_s = bus.sent[0].timestamp - float(sound.t_s[0])
    changed = [
        wrong.timestamp - begin_s
        for wrong, payload in zip(bus.sent, sound.data, strict=False)
        if wrong.arbitration_id == can_id and bytes(wrong.data) != bytes(payload)
    ]
    (begun,) = sent.drive.totals.faults
    asked_s = 0.5 + float(sound.t_s[0])
    assert asked_s < changed[0] <= asked_s + 0.1
    assert begun.t_start_s <= changed[0]


def test_something_goes_wrong_with_the_car_itself_while_it_drives() -> None:
    scenario = replace(drive_scenario(seed=41), adapted=True)
    (glazed, sound) = (Drive(scenario), Drive(scenario))
    before, same = (next(drive.stretches(6.0)) for drive in (glazed, sound))
    assert (before.frames.data == same.frames.data).all()
    glazed.add_fault(Degradation(kind=CauseKind.GLAZED_LINING, clutch=2, strength=3.0))
    worse, well = ([truth for truth in next(drive.stretches(4.0)).truths if isinstance(truth, ShiftTruth)]
                   for drive in (glazed, sound))  # fmt: skip
    (begun,) = glazed.totals.faults
    assert (begun.what, begun.kind, begun.size, begun.t_end_s) == ("clutch2", "glazed-lining", 3.0, None)
    assert begun.t_start_s == pytest.approx(6.0, abs=0.01)
    assert begun.t_start_s < worse[0].t_start_s
    assert worse[0].clutch == well[0].clutch == 2
    assert worse[0].mu_c < 0.95 * well[0].mu_c


def test_a_car_takes_its_faults_onto_the_next_trip_and_its_sensors_drift_at_once() -> None:
    drive = Drive(replace(load_scenario("noise_only"), drive=DriveName.DAY), longest_stay_s=1.0)
    assert drive.advance(5.0) is not None
    drive.add_fault(Degradation(kind=CauseKind.TORQUE_SENSOR, strength=4.0))
    drive.end_trip()
    first, second = drive.advance(5.0), drive.advance(5.0)
    assert first is not None
    assert second is not None
    assert first.end_s == pytest.approx(5.0, abs=0.01)
    assert [truth.number for truth in second.truths if isinstance(truth, TripTruth)] == [2]
    assert drive.totals.faults[0].kind == "torque-sensor"


def test_an_engine_that_is_off_is_silent_for_as_long_as_the_clock_says() -> None:
    clock = iter([100.0, 107.5])
    drive = Drive(replace(load_scenario("ideal"), drive=DriveName.CITY))
    orders, stop = LiveOrders(drive, lambda: next(clock)), threading.Event()
    stretches = drive.stretches(2.0)
    last = next(stretches)
    with pytest.raises(EmulatorConfigError, match="on already"):
        orders.switch_engine(is_on=True)
    orders.switch_engine(is_on=False)
    assert len(next(stretches).frames)  # of the one row in which it is switched off
    assert drive.is_off
    waiting = threading.Thread(target=orders.stay, args=(stop,))
    waiting.start()
    while waiting.is_alive():
        with suppress(EmulatorConfigError, StopIteration):
            orders.switch_engine(is_on=True)
        waiting.join(0.01)
    again = next(stretches)
    assert float(again.frames.t_s[0]) == pytest.approx(last.end_s + 7.5, abs=0.02)
    with pytest.raises(EmulatorConfigError, match="shift cycles"):
        Drive(drive_scenario()).end_trip()


def trip_numbers(drive: Drive, stop: threading.Event, orders: LiveOrders, count: int) -> list[int]:
    """Return the trips that begin within some stretches of the drive, whose stays end by orders alone."""
    numbers = list[int]()
    for _ in range(count):
        if drive.finished:
            break
        stretch = drive.advance(0.02)
        numbers += [truth.number for truth in stretch.truths if isinstance(truth, TripTruth)] if stretch else []
        staying = threading.Thread(target=orders.stay, args=(stop,))
        staying.start()
        staying.join(HANG_S)
        assert not staying.is_alive(), "the car waits to be switched on, though it was"
    return numbers


def test_orders_that_come_within_a_step_are_all_carried_out_in_their_order() -> None:
    """Somebody who presses a button twice means both."""
    times_s = iter([100.0, 100.001, 107.0, 107.5])
    drive = Drive(replace(load_scenario("ideal"), drive=DriveName.CITY))
    orders, stop = LiveOrders(drive, lambda: next(times_s)), threading.Event()
    assert drive.advance(2.0) is not None
    orders.switch_engine(is_on=False)
    with pytest.raises(EmulatorConfigError, match="the engine is off already"):
        orders.switch_engine(is_on=False)
    orders.switch_engine(is_on=True)
    with pytest.raises(EmulatorConfigError, match="the engine is on already"):
        orders.switch_engine(is_on=True)
    orders.switch_engine(is_on=False)
    orders.switch_engine(is_on=True)
    orders.end_trip()
    orders.end_trip()
    assert trip_numbers(drive, stop, orders, 12) == [2, 3]
    assert drive.finished  # a drive of one trip: it was switched on again twice, and ended for good


def test_trips_of_a_day_that_are_ended_at_once_are_all_ended() -> None:
    drive = Drive(replace(load_scenario("ideal"), drive=DriveName.DAY), longest_stay_s=1.0)
    orders, stop = LiveOrders(drive), threading.Event()
    assert drive.advance(2.0) is not None
    for _ in range(3):
        orders.end_trip()
    assert trip_numbers(drive, stop, orders, 8) == [2, 3, 4]


def test_a_car_that_is_off_takes_no_order_to_drive() -> None:
    drive = Drive(replace(load_scenario("ideal"), drive=DriveName.CITY))
    orders = LiveOrders(drive)
    orders.switch_engine(is_on=False)
    with pytest.raises(EmulatorConfigError, match="the engine is off: there is no trip to end"):
        orders.end_trip()
    with pytest.raises(EmulatorConfigError, match="the engine is off: there is no gear to engage"):
        orders.request_gear(3)


def test_a_gear_is_engaged_on_request_and_the_map_goes_on_afterwards() -> None:
    drive = Drive(replace(load_scenario("ideal"), drive=DriveName.HWFET))
    assert drive.advance(60.0) is not None  # at 70 km/h in the highest gear
    drive.request_gear(4)
    stretch = drive.advance(10.0)
    assert stretch is not None
    assert [(truth.from_gear, truth.to_gear) for truth in stretch.truths if isinstance(truth, EventTruth)][:2] == [
        (6, 5), (5, 4),
    ]  # fmt: skip
    with pytest.raises(EmulatorConfigError, match=r"gear must be a whole number, 1\.\.6"):
        drive.request_gear(7)
