"""Days of trips with the car parked in between: what becomes of trouble codes, and what counts from the start."""

import can
import numpy as np
import pytest

from canlog.e2e.message_contract import message_contracts
from canlog.e2e.profile1 import counter_of, crc_is_valid, data_id_remainder
from dbc.contract import load_contract
from tests.support.uds.days import HOLDING, TripCar
from workshop.controller.iso14229 import DtcStatus

COLD = (293.0, 350.0)  # coolant in the morning, and after the trip [K]
WARM = (335.0, 350.0)  # after lunch: no warm-up cycle, it becomes warmer by 15 K only
SLIPPING = {"hub_speed_rad_s": 166.4, "engine_speed_rad_s": 166.4}
STANDING = {"vehicle_speed_m_s": 0.0}
CONTRACTS = message_contracts(load_contract())
OWN_IDS = {one.can_id for one in CONTRACTS.values() if one.sender == "TCU"}
OTHER_IDS = {one.can_id for one in CONTRACTS.values()} - OWN_IDS
SHIFT_DATA_ID = CONTRACTS["TCU_Shift"].data_id or 0
LIFE = 43


def day(car: TripCar) -> None:
    """Drive two sound trips, the first one with a cold engine."""
    for coolant_k in (COLD, WARM):
        car.park()
        car.drive(coolant_k)


def test_days_of_trips_confirm_heal_and_forget_a_code_as_the_table_says() -> None:
    """P0811: two cycles to confirm, three to heal, forty warm-ups to forget."""
    car, seen = TripCar(), []
    car.drive(COLD, SLIPPING)
    seen.append(car.status("P0811"))
    car.park()
    seen.append(car.status("P0811"))  # nothing is known of the trip that begins
    car.drive(WARM, SLIPPING)
    seen.append(car.status("P0811"))
    for _ in range(4):
        car.park()
        car.drive(WARM)
        seen.append(car.status("P0811"))
    assert [f"{status:02x}" for status in seen] == ["27", "27", "af", "ac", "a8", "a8", "28"]
    assert car.ask("03") == "43 01 08 11"
    assert car.ask("0A") == "4a 00"  # it is no longer permanent
    days = 0
    while car.status("P0811") & DtcStatus.CONFIRMED and days < LIFE:
        day(car)
        days += 1
    assert days == 40  # in the second trip of the fortieth day: its first one was the warm-up
    assert car.status("P0811") == 0x20
    assert car.ask("03") == "43 00"
    assert car.ask("01 30") == "41 30 29"  # of the day it failed, and of these


def own_frames(car: TripCar) -> list[can.Message]:
    return [message for message in car.bus.messages if message.arbitration_id in OWN_IDS]


def test_a_reset_silences_the_controller_until_it_has_started_and_it_counts_anew() -> None:
    car = TripCar()
    car.drive(changes=STANDING, steps=20)
    car.ask("10 03")
    car.bus.messages.clear()
    assert car.ask("11 01") == "51 01"
    for _ in range(3):  # a frame of each message every 100 ms, for as long as it takes to start
        car.say(HOLDING | STANDING)
        car.t_s = round(car.t_s + 0.1, 3)
        assert own_frames(car) == []
        assert car.ask("3E 00") == ("" if car.t_s < 10.29 else "7e 00")
    assert {message.arbitration_id for message in car.bus.messages} == OTHER_IDS  # nobody else is reset
    for _ in range(20):
        car.say(HOLDING | STANDING)
        car.t_s = round(car.t_s + 0.1, 3)
    shifts = np.array([list(message.data) for message in own_frames(car) if message.arbitration_id == 0x0B3], np.uint8)
    assert counter_of(shifts).tolist() == [*range(15), *range(5)]
    assert crc_is_valid(shifts, data_id_remainder(SHIFT_DATA_ID)).all()
    assert int(car.ask("22 01 00")[9:].replace(" ", ""), 16) / 100.0 == pytest.approx(2.0)
    assert car.ask("22 F1 86") == "62 f1 86 01"
    car.bus.messages.clear()
    car.park()
    car.drive(steps=2)
    later = np.array([list(message.data) for message in own_frames(car) if message.arbitration_id == 0x0B3], np.uint8)
    assert counter_of(later).tolist() == [0, 1]


def test_nothing_is_reset_cleared_or_switched_off_while_the_car_drives() -> None:
    car = TripCar()
    car.drive(changes={**SLIPPING, "vehicle_speed_m_s": 21.1})  # 76 km/h
    car.ask("10 03")
    asked = ("11 01", "28 03 01", "85 02", "14 FF FF FF", "14 08 11 07")
    assert [car.ask(request) for request in asked] == [
        "7f 11 88", "7f 28 88", "7f 85 88", "7f 14 22", "7f 14 22",
    ]  # fmt: skip
    car.drive(changes=STANDING, steps=1)
    assert [car.ask(request)[:2] for request in asked[1:]] == ["68", "c5", "54", "54"]
